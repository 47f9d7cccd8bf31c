"""Where a person's wish to arm or disarm comes in: the query `hand/arm`."""

from __future__ import annotations

from dataclasses import replace

from common.desk import Desk
from common.hand_messages import ArmReply, ArmRequest
from common.messages import Message
from common.topics import ARM_REQUEST

QUERY = "hand/arm"


class ArmDesk(Desk[ArmReply]):
    """Answers with an ArmReply."""

    def __init__(self, boot_id: int) -> None:
        super().__init__("arm", boot_id, ARM_REQUEST, ArmReply, lambda reason: ArmReply(False, "", reason))

    def _dated(self, request: Message, deadline_ns: int) -> Message:
        return replace(request, deadline_ns=deadline_ns) if isinstance(request, ArmRequest) else request

"""Where a person's wish to arm or disarm comes in: the query `hand/arm`."""

from __future__ import annotations

from common.desk import Desk
from common.hand_messages import ArmReply
from common.topics import ARM_REQUEST

QUERY = "hand/arm"


class ArmDesk(Desk[ArmReply]):
    """Answers with an ArmReply."""

    def __init__(self, boot_id: int) -> None:
        super().__init__("arm", boot_id, ARM_REQUEST, ArmReply, lambda reason: ArmReply(False, "", reason))

"""Where a person's wish comes in: the query `hand/arm`, passed to the service as a port's message."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

from common.codec import Codec, Refused
from common.hand_messages import ArmReply
from common.messages import Header, Message
from common.topics import ARM_REQUEST, Topic

QUERY = "hand/arm"
ANSWER_S = 2.0
_NO_ANSWER = ArmReply(accepted=False, state="", reason="hand_io does not answer: see its log")


class ArmDesk:
    """Hands each query to the service and its reply back; one at a time."""

    name = "arm"

    def __init__(self, boot_id: int) -> None:
        self._boot_id = boot_id
        self._codec = Codec()
        self._replies: SimpleQueue[ArmReply] = SimpleQueue()
        self._deliver: Callable[[Topic, Message], None] | None = None
        self._one = threading.Lock()

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Begin to pass wishes on."""
        self._deliver = deliver

    def write(self, message: Message) -> None:
        """Take the service's reply."""
        if not isinstance(message, ArmReply):
            raise TypeError(f"the desk takes ArmReply, got {type(message).__name__}")
        self._replies.put(message)

    def answer(self, payload: bytes) -> bytes:
        """Answer one query; a payload that is no request is answered, and goes no further."""
        with self._one:
            return self._encoded(self._reply(payload))

    def _reply(self, payload: bytes) -> ArmReply:
        try:
            request = self._codec.decode(ARM_REQUEST.key, payload).message
        except Refused as error:
            return ArmReply(accepted=False, state="", reason=f"not understood: {error}")
        if self._deliver is None:
            return _NO_ANSWER
        while not self._replies.empty():  # of a query that nobody waits for any more
            self._replies.get()
        self._deliver(ARM_REQUEST, request)
        try:
            return self._replies.get(timeout=ANSWER_S)
        except Empty:
            return _NO_ANSWER

    def _encoded(self, reply: ArmReply) -> bytes:
        return self._codec.encode(Header(self._boot_id, 0, 0, True), reply)

    def close(self) -> None:
        """Pass nothing on any more."""
        self._deliver = None

"""Where people's wishes come in: a query, passed to a service as a port's message, and its reply back."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from common.clock import WallClock
from common.codec import Codec, Refused
from common.messages import Header, Message
from common.topics import Topic

ANSWER_S = 2.0
GRACE_S = 0.3  # for the reply of a service that began to answer in time
NS_PER_S = 1e9
ReplyT = TypeVar("ReplyT", bound=Message)


class Desk(Generic[ReplyT]):
    """Hands each query to the service as a message of `request`; one at a time, each for ANSWER_S in all.

    `refusal` makes the reply that says why there is none of the service.
    """

    def __init__(
        self, name: str, boot_id: int, request: Topic, reply: type[ReplyT], refusal: Callable[[str], ReplyT]
    ) -> None:
        self.name = name
        self._boot_id = boot_id
        self._request, self._reply, self._refusal = request, reply, refusal
        self._codec, self._clock = Codec(), WallClock()
        self._replies: SimpleQueue[ReplyT] = SimpleQueue()
        self._deliver: Callable[[Topic, Message], None] | None = None
        self._one = threading.Lock()

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Begin to pass wishes on."""
        self._deliver = deliver

    def write(self, message: Message) -> None:
        """Take the service's reply."""
        if not isinstance(message, self._reply):
            raise TypeError(f"the desk takes {self._reply.__name__}, got {type(message).__name__}")
        self._replies.put(message)

    def answer(self, payload: bytes) -> bytes:
        """Answer one query; a payload that is no request is answered, and goes no further."""
        deadline_ns = self._clock.now_ns() + round(ANSWER_S * NS_PER_S)
        if not self._one.acquire(timeout=ANSWER_S):
            return self._encoded(self._refusal("others are asking: try again"))
        try:
            return self._encoded(self._answer(payload, deadline_ns))
        finally:
            self._one.release()

    def _encoded(self, reply: ReplyT) -> bytes:
        return self._codec.encode(Header(self._boot_id, 0, 0, True), reply)

    def _dated(self, request: Message, deadline_ns: int) -> Message:
        """The request as the service gets it; one that it must not obey after the deadline says so."""
        return request

    def _answer(self, payload: bytes, deadline_ns: int) -> ReplyT:
        try:
            request = self._codec.decode(self._request.key, payload).message
        except Refused as error:
            return self._refusal(f"not understood: {error}")
        if self._deliver is None:
            return self._refusal("the service does not answer: see its log")
        while not self._replies.empty():  # of a query that nobody waits for any more
            self._replies.get()
        self._deliver(self._request, self._dated(request, deadline_ns))
        left_s = max(0.0, (deadline_ns - self._clock.now_ns()) / NS_PER_S)
        try:
            return self._replies.get(timeout=left_s + GRACE_S)
        except Empty:
            return self._refusal("the service does not answer: see its log")

    def close(self) -> None:
        """Pass nothing on any more."""
        self._deliver = None

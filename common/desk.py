"""Where people's wishes come in: a query, passed to a service as a port's message, and its reply back."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from common.codec import Codec, Refused
from common.messages import Header, Message
from common.topics import Topic

ANSWER_S = 2.0
ReplyT = TypeVar("ReplyT", bound=Message)


class Desk(Generic[ReplyT]):
    """Hands each query to the service as a message of `request`; one at a time.

    `refusal` makes the reply that says why there is none of the service.
    """

    def __init__(
        self, name: str, boot_id: int, request: Topic, reply: type[ReplyT], refusal: Callable[[str], ReplyT]
    ) -> None:
        self.name = name
        self._boot_id = boot_id
        self._request, self._reply, self._refusal = request, reply, refusal
        self._codec = Codec()
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
        with self._one:
            return self._codec.encode(Header(self._boot_id, 0, 0, True), self._answer(payload))

    def _answer(self, payload: bytes) -> ReplyT:
        try:
            request = self._codec.decode(self._request.key, payload).message
        except Refused as error:
            return self._refusal(f"not understood: {error}")
        if self._deliver is None:
            return self._refusal("the service does not answer: see its log")
        while not self._replies.empty():  # of a query that nobody waits for any more
            self._replies.get()
        self._deliver(self._request, request)
        try:
            return self._replies.get(timeout=ANSWER_S)
        except Empty:
            return self._refusal("the service does not answer: see its log")

    def close(self) -> None:
        """Pass nothing on any more."""
        self._deliver = None

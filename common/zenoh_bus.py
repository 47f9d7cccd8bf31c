"""The bus between processes: every process is a Zenoh client of one router."""

# Zenoh's stubs leave handlers and payloads partly untyped.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportMissingModuleSource=false

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext
from zenoh.handlers import FifoChannel, RingChannel

from common.bus import Sink
from common.bus_config import BusConfig
from common.topics import Priority, Topic
from common.zenoh_router import BusError, open_session

CLOSE_S = 2.0
ALIVE_TIMEOUT_S = 1.0
HEARTBEAT_S = 0.2  # publishers of recovered topics say how far they are: bounds the delay of a recovery
QUEUE = 1024  # samples between Zenoh's threads and ours; when full, Zenoh waits and nothing is lost here

_PRIORITIES = {
    Priority.REAL_TIME: zenoh.Priority.REAL_TIME,
    Priority.DATA: zenoh.Priority.DATA,
    Priority.BACKGROUND: zenoh.Priority.BACKGROUND,
}


class ZenohBus:
    """Publishes and subscribes below `<cell>/`, and shows itself as alive under `name`.

    Delivery, per topic: latched samples reach late joiners; recovered topics are asked for again when a gap
    shows, as far as the sender's cache reaches. After a router's or a sender's restart a sample may arrive
    twice: receivers compare boot_id and seq. Raises BusError when there is no router within the timeout.
    """

    def __init__(self, config: BusConfig, cell: str, name: str) -> None:
        self._prefix = f"{cell}/"
        self._session = open_session(config)
        self._lock = threading.Lock()
        self._publishers: dict[str, Any] = {}
        self._declared: list[Any] = []  # Zenoh forgets what nobody holds
        self._threads: list[threading.Thread] = []
        self._miss_listeners: list[tuple[str, Any]] = []
        self._misses: dict[str, int] = {}
        self._closed = False
        self._sender = _NewestSender(self._put)
        self.callback_errors = 0
        self._declared.append(self._session.liveliness().declare_token(f"{cell}/alive/{name}"))
        atexit.register(self.close)

    def publish(self, topic: Topic, key: str, payload: bytes) -> None:
        """Send at once, or hand to the sender thread if the topic blocks; there only the newest waits."""
        if topic.block:
            self._sender.post(topic, key, payload)
        else:
            self._put(topic, key, payload)

    def _put(self, topic: Topic, key: str, payload: bytes) -> None:
        try:
            publisher = self._publishers.get(key) or self._declare(topic, key)
            publisher.put(payload)
        except zenoh.ZError as error:
            if not self._closed:
                raise BusError(f"bus: cannot publish on {key}: {error}") from None

    def _declare(self, topic: Topic, key: str) -> Any:
        with self._lock:
            if key not in self._publishers:
                self._publishers[key] = _publisher(self._session, topic, self._prefix + key)
            return self._publishers[key]

    def subscribe(self, topic: Topic, sink: Sink) -> None:
        """Call `sink` on a thread of this subscription: what is latched first, then what follows."""
        subscriber = _subscriber(self._session, topic, self._prefix + topic.key)
        if topic.latched:
            self._miss_listeners.append((topic.key, subscriber.sample_miss_listener(RingChannel(QUEUE))))

        def deliver(sample: zenoh.Sample) -> None:
            sink(str(sample.key_expr).removeprefix(self._prefix), sample.payload.to_bytes())

        self._drain(subscriber, deliver, f"bus {topic.key}")

    def serve(self, key: str, handler: Callable[[bytes], bytes]) -> None:
        """Answer queries on `key`, one at a time on a thread of their own."""
        full_key = self._prefix + key
        queryable = self._session.declare_queryable(full_key, FifoChannel(QUEUE))

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(full_key, handler(query.payload.to_bytes() if query.payload else b""))

        self._drain(queryable, answer, f"bus {key}")

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        """Query `key` and return the first answer, or None when none came in time."""
        replies = self._session.get(
            self._prefix + key,
            FifoChannel(16),
            payload=payload,
            timeout=timeout_s,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        return next((reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None), None)

    def alive(self) -> tuple[str, ...]:
        """Name the processes whose link to the router stands, this one included."""
        pattern = f"{self._prefix}alive/*"
        replies = self._session.liveliness().get(pattern, FifoChannel(QUEUE), timeout=ALIVE_TIMEOUT_S)
        keys = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        return tuple(sorted(key.removeprefix(f"{self._prefix}alive/") for key in keys))

    @property
    def misses(self) -> dict[str, int]:
        """Samples that were lost for good, per subscribed topic."""
        for key, listener in self._miss_listeners:
            while (miss := listener.try_recv()) is not None:
                self._misses[key] = self._misses.get(key, 0) + miss.nb
        return dict(self._misses)

    def _drain(self, declared: Any, handle: Callable[[Any], None], name: str) -> None:
        """Feed `handle` on a daemon thread: Zenoh's own callback threads would keep the process alive."""
        handler = declared.handler  # read once: `declared` is locked while close undeclares it

        def loop() -> None:
            """Until `close` undeclares; what `handle` raises is counted."""
            while True:
                try:
                    item = handler.recv()
                except zenoh.ZError:
                    return  # undeclared by close
                try:
                    handle(item)
                except Exception:
                    self.callback_errors += 1

        self._declared.append(declared)
        self._threads.append(threading.Thread(target=loop, name=name, daemon=True))
        self._threads[-1].start()

    def close(self) -> None:
        """Send what still waits, then leave; returns within two seconds and may be called twice."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        deadline = time.monotonic() + CLOSE_S
        self._sender.close(deadline)
        closing = threading.Thread(target=self._leave, name="bus close", daemon=True)
        closing.start()
        for thread in (closing, *self._threads):
            thread.join(max(0.0, deadline - time.monotonic()))

    def _leave(self) -> None:
        for declared in reversed(self._declared):
            declared.undeclare()
        self._session.close()


class _NewestSender:
    """A thread that puts payloads which may block; of each key only the newest waits."""

    def __init__(self, put: Callable[[Topic, str, bytes], None]) -> None:
        self._put = put
        self._waiting: dict[str, tuple[Topic, bytes]] = {}
        self._changed = threading.Condition()
        self._closing = False
        self._thread: threading.Thread | None = None

    def post(self, topic: Topic, key: str, payload: bytes) -> None:
        with self._changed:
            self._waiting[key] = (topic, payload)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="bus sender", daemon=True)
                self._thread.start()
            self._changed.notify()

    def _run(self) -> None:
        while (item := self._next()) is not None:
            self._put(*item)

    def _next(self) -> tuple[Topic, str, bytes] | None:
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting) or self._closing)
            if not self._waiting:
                return None
            key = next(iter(self._waiting))
            topic, payload = self._waiting.pop(key)
            return topic, key, payload

    def close(self, deadline: float) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(max(0.0, deadline - time.monotonic()))


def _publisher(session: zenoh.Session, topic: Topic, full_key: str) -> Any:
    congestion = zenoh.CongestionControl.BLOCK if topic.block else zenoh.CongestionControl.DROP
    rank: dict[str, Any] = {
        "priority": _PRIORITIES[topic.priority],
        "express": topic.priority is Priority.REAL_TIME,
    }
    if not topic.latched:
        return session.declare_publisher(full_key, congestion_control=congestion, **rank)
    # Answers to late joiners must not be dropped half-way: a fragmented snapshot would never arrive.
    replies = ext.RepliesConfig(congestion_control=zenoh.CongestionControl.BLOCK, **rank)
    return ext.declare_advanced_publisher(
        session,
        full_key,
        congestion_control=congestion,
        **rank,
        cache=ext.CacheConfig(topic.latched, replies_config=replies),
        publisher_detection=True,
        # Sequence numbers rather than time stamps: clocks need not agree.
        sample_miss_detection=_miss_detection(topic),
    )


def _miss_detection(topic: Topic) -> ext.MissDetectionConfig:
    # The stub demands both options although they exclude each other.
    options: dict[str, Any] = {"sporadic_heartbeat": HEARTBEAT_S} if topic.recovered else {}
    return ext.MissDetectionConfig(**options)


def _subscriber(session: zenoh.Session, topic: Topic, full_key: str) -> Any:
    queue = RingChannel(topic.ring) if topic.ring else FifoChannel(QUEUE)
    if not topic.latched:
        return session.declare_subscriber(full_key, queue)
    recovery: dict[str, Any] = {"heartbeat": True}
    return ext.declare_advanced_subscriber(
        session,
        full_key,
        queue,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=topic.latched),
        recovery=ext.RecoveryConfig(**recovery) if topic.recovered else None,
    )

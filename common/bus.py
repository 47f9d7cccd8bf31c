"""The Bus protocol, the in-process LocalBus, and the Inbox that turns payloads into checked inputs."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from common.codec import Codec, Refused
from common.messages import Sample
from common.topics import Topic

Sink = Callable[[str, bytes], None]  # (key without the cell's prefix, payload); must return at once

ALL_WAITING = 8192
ALIVE_PERIODS = 10
ALIVE_MIN_NS = 2_000_000_000
RATE_SHARE = 0.9
RATE_WINDOW = 20


class Bus(Protocol):
    """Carries payloads between processes, or within one."""

    def publish(self, topic: Topic, key: str, payload: bytes) -> None:
        """Send; never blocks the caller for long and never raises when nobody listens."""
        ...

    def subscribe(self, topic: Topic, sink: Sink) -> None:
        """Call `sink` for every payload of the topic, latched ones first; on any thread."""
        ...

    @property
    def misses(self) -> dict[str, int]:
        """Samples that the transport lost for good, per key."""
        ...

    def close(self) -> None:
        """Stop delivering and release threads and sockets."""
        ...


class LocalBus:
    """A bus within one process: delivery happens inside `publish`, in the order of subscription."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._sinks: list[tuple[Topic, Sink]] = []
        self._latched: dict[str, deque[bytes]] = {}

    def publish(self, topic: Topic, key: str, payload: bytes) -> None:
        """Deliver to every subscriber now and keep it for late ones if the topic is latched."""
        with self._lock:
            if topic.latched:
                self._latched.setdefault(key, deque(maxlen=topic.latched)).append(payload)
            sinks = [sink for wanted, sink in self._sinks if wanted == topic]
        for sink in sinks:
            sink(key, payload)

    def subscribe(self, topic: Topic, sink: Sink) -> None:
        """Deliver what is latched, then everything that follows."""
        with self._lock:
            self._sinks.append((topic, sink))
            kept = [(key, payload) for key, payloads in self._latched.items() for payload in payloads]
        for key, payload in kept:
            if topic.key == key or (topic.key.endswith("/*") and key.startswith(topic.key[:-1])):
                sink(key, payload)

    @property
    def misses(self) -> dict[str, int]:
        """Nothing is ever lost within a process."""
        return {}

    def close(self) -> None:
        """Forget subscribers and latched payloads."""
        with self._lock:
            self._sinks.clear()
            self._latched.clear()


@dataclass(frozen=True)
class Input:
    """A topic that a service reads: `newest` keeps one sample per key, else all are queued in order."""

    topic: Topic
    newest: bool = False
    wake: bool = False  # step at once when a sample arrives, not only at the next tick


@dataclass(frozen=True)
class InputStatus:
    """Whether an input can be trusted now."""

    alive: bool  # seen within ten nominal periods (at least two seconds); without a rate: ever seen
    rate_ok: bool  # at least nine tenths of the nominal rate over the last samples
    valid: bool  # the newest sample says so
    age_ns: int  # since the newest sample arrived; -1: never


@dataclass(frozen=True)
class JobResult:
    """What came of a job: its value, or the error as one line."""

    name: str
    value: object
    error: str
    duration_ns: int  # measured live, declared in lock-step


class _Mailbox:
    """Samples of one input, with their wire bytes, on their way from the bus's threads to the loop."""

    def __init__(self, spec: Input) -> None:
        self.spec = spec
        self.waiting: deque[tuple[Sample, bytes]] = deque()
        self.dropped = 0  # lost because nobody read in time; superseded samples of `newest` do not count
        self.samples: deque[Sample] = deque()
        self.latest: Sample | None = None
        self.arrivals_ns: deque[int] = deque(maxlen=RATE_WINDOW)

    def put(self, sample: Sample, payload: bytes) -> None:
        if self.spec.newest:
            self.waiting = deque(item for item in self.waiting if item[0].key != sample.key)
        elif len(self.waiting) >= ALL_WAITING:
            self.waiting.popleft()
            self.dropped += 1
        self.waiting.append((sample, payload))


class Inbox:
    """All inputs of one service: sinks may be called on any thread, everything else on the service's loop.

    Payloads are checked as they come: one that is refused is counted, and never displaces a good one.
    """

    def __init__(self, codec: Codec, inputs: Iterable[Input]) -> None:
        self._codec = codec
        self._lock = threading.Lock()
        self._boxes = {spec.topic: _Mailbox(spec) for spec in inputs}
        self._results_waiting: deque[JobResult] = deque()
        self.results: list[JobResult] = []  # finished since the last step
        self.ticks = 0  # deadlines passed since the last step; 0: woken by a sample or a result
        # Per topic: keys are the sender's choice, and a heartbeat with too many of them would not be sent.
        self.refused: dict[str, int] = {}
        self.last_refusal = ""
        self.wake = threading.Event()

    def sink(self, topic: Topic) -> Sink:
        """Return the function that the bus calls with payloads of `topic`."""
        box = self._boxes[topic]

        def deliver(key: str, payload: bytes) -> None:
            """Decode and put into the box, or count the refusal; runs on the bus's thread."""
            try:
                sample = self._codec.decode(key, payload)
            except Refused as error:
                self._refuse(topic, key, error)
                return
            with self._lock:
                box.put(sample, payload)
            if box.spec.wake:
                self.wake.set()

        return deliver

    def _refuse(self, topic: Topic, key: str, error: Refused) -> None:
        with self._lock:
            self.refused[topic.key] = self.refused.get(topic.key, 0) + 1
            self.last_refusal = f"{key}: {error}"

    def finish(self, result: JobResult) -> None:
        """Hand over a finished job's result and wake the loop."""
        with self._lock:
            self._results_waiting.append(result)
        self.wake.set()

    def collect(self, now_ns: int, ticks: int) -> tuple[list[tuple[str, bytes]], list[JobResult]]:
        """Show what has arrived and return it raw, as the bus log wants it. Once before every step."""
        self.wake.clear()
        self.ticks = ticks
        with self._lock:
            arrived = [(box, *item) for box in self._boxes.values() for item in box.waiting]
            for box in self._boxes.values():
                box.waiting = deque()
            self.results = list(self._results_waiting)
            self._results_waiting.clear()
        for box in self._boxes.values():
            box.samples.clear()
        for box, sample, _ in arrived:
            box.samples.append(sample)
            box.latest = sample
            box.arrivals_ns.append(now_ns)
        return [(sample.key, payload) for _, sample, payload in arrived], self.results

    def take(self, topic: Topic) -> list[Sample]:
        """Return the samples that arrived since the last step, oldest first."""
        return list(self._boxes[topic].samples)

    def newest(self, topic: Topic) -> Sample | None:
        """Return the newest sample ever received, of any key of the topic."""
        return self._boxes[topic].latest

    @property
    def dropped(self) -> dict[str, int]:
        """Frames lost before they were read, per topic."""
        return {topic.key: box.dropped for topic, box in self._boxes.items() if box.dropped}

    def status(self, topic: Topic, now_ns: int) -> InputStatus:
        """Tell whether the input is alive, at its rate and valid."""
        box = self._boxes[topic]
        if box.latest is None or not box.arrivals_ns:
            return InputStatus(False, False, False, -1)
        age = now_ns - box.arrivals_ns[-1]
        period = 1e9 / topic.rate_hz if topic.rate_hz else None
        alive = period is None or age <= max(ALIVE_PERIODS * period, ALIVE_MIN_NS)
        span = box.arrivals_ns[-1] - box.arrivals_ns[0]
        arrived = len(box.arrivals_ns) - 1
        rate_ok = period is None or (alive and arrived * period >= RATE_SHARE * span)
        return InputStatus(alive, rate_ok, box.latest.header.valid, age)

    def stale(self, now_ns: int) -> tuple[str, ...]:
        """Name the inputs with a nominal rate that are not alive."""
        return tuple(t.key for t in self._boxes if t.rate_hz and not self.status(t, now_ns).alive)

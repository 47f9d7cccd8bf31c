"""The replay runner: one service over its recorded bus log; every frame that it sends is compared.

The log is the clock, the bus and the devices: a step happens when the log says so, with the inputs and job
results that it names. Jobs are computed again, in their order, and take as long as they did.
"""

from __future__ import annotations

import dataclasses
import struct
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from common.bus import JobResult, LocalBus
from common.buslog import Entry
from common.codec import Codec, Refused
from common.messages import Message
from common.runner import Dispatcher, run_job
from common.service import Job, Port, Service
from common.topics import HEALTH, Topic, topic_of

SHOWN = 20  # the first differences are kept: what follows them is mostly their consequence


class ReplayError(Exception):
    """A log that cannot be replayed; the message is one line that says why."""


@dataclass(frozen=True)
class Comparison:
    """What may differ: fields that are not compared, and the largest accepted deviation of others."""

    ignored: frozenset[str] = frozenset()
    tolerances: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class Difference:
    """One field of one frame that came out otherwise; `step` counts the steps of the log from 0."""

    step: int
    t_ns: int
    key: str
    field: str
    recorded: str
    replayed: str

    def __str__(self) -> str:
        return f"step {self.step}: {self.key}: {self.field}: recorded {self.recorded}, now {self.replayed}"


@dataclass
class ReplayReport:
    """What came of a replay; `differences` holds the first ones, `differing` counts all."""

    steps: int = 0
    frames: int = 0  # compared, equal or not
    differing: int = 0
    differences: list[Difference] = field(default_factory=list[Difference])

    def add(self, difference: Difference) -> None:
        """Count a difference, and keep it if it is among the first."""
        self.differing += 1
        if len(self.differences) < SHOWN:
            self.differences.append(difference)


@dataclass
class _Turn:
    """One step of the log: what it saw and what was sent after it."""

    now_ns: int
    ticks: int
    inputs: list[Entry]
    results: list[Entry]
    sent: list[Entry] = field(default_factory=list[Entry])


class _SentFrames:
    """A log sink that keeps the frames that the service sends."""

    failed = ""

    def __init__(self) -> None:
        self._frames: list[Entry] = []

    def write(self, entry: Entry) -> None:
        if entry.kind == "out":
            self._frames.append(entry)

    def flush(self) -> None:
        """Nothing is buffered."""

    def close(self) -> None:
        """Nothing is open."""

    def take(self) -> list[Entry]:
        frames, self._frames = self._frames, []
        return frames


class _LoggedPort:
    """Stands where a device was: its frames come from the log, so commands end here."""

    name = "logged"

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Frames come from the log."""

    def write(self, message: Message) -> None:
        """The command has been compared already."""

    def close(self) -> None:
        """Nothing is open."""


class Replay:
    """Feeds one fresh service with a log and compares what it sends."""

    def __init__(self, service: Service, codec: Codec, comparison: Comparison | None = None) -> None:
        self.report = ReplayReport()
        self._codec = codec
        self._comparison = comparison or Comparison()
        self._sent = _SentFrames()
        ports: Mapping[str, Port] = defaultdict(_LoggedPort)
        self._dispatcher = Dispatcher(service, codec, LocalBus(), ports, self._sent)
        self._jobs: list[Job] = []  # under way, in the order in which they were begun

    def run(self, entries: Iterable[Entry]) -> ReplayReport:
        """Replay a log from its first entry on. Raises ReplayError if it does not begin with a step."""
        previous: _Turn | None = None
        for turn in _turns(entries, HEALTH.key.replace("*", self._dispatcher.service.name)):
            if previous is not None:
                self._compare(previous, self._sent.take())
                self.report.steps += 1
            self._step(turn)
            previous = turn
        if previous is not None:
            self._end(previous)
        return self.report

    def _step(self, turn: _Turn) -> None:
        for entry in turn.inputs:
            self._deliver(entry)
        for entry in turn.results:
            self._finish(entry)
        self._dispatcher.step(turn.now_ns, turn.ticks, self._jobs.append)

    def _deliver(self, entry: Entry) -> None:
        try:
            sink = self._dispatcher.inbox.sink(topic_of(entry.key))
        except KeyError:
            self._differ(entry, "(input)", "delivered", "not an input of this service")
            return
        sink(entry.key, entry.payload)

    def _finish(self, entry: Entry) -> None:
        """Compute the job that the log says has finished, and show its result."""
        under_way = self._oldest_jobs()
        job = next((job for job in under_way if job.name == entry.key), None)
        if job is None:
            names = " ".join(job.name for job in under_way) or "none"
            self._differ(entry, "(job)", f"{entry.key} finished", f"under way: {names}")
            return
        self._jobs = [each for each in self._jobs if each is not job]
        value, error = run_job(job)
        self._dispatcher.inbox.finish(JobResult(entry.key, value, error, _number(entry)))

    def _oldest_jobs(self) -> list[Job]:
        """Of each lane the job that is next to finish."""
        lanes: dict[str, Job] = {}
        for job in self._jobs:
            lanes.setdefault(job.lane, job)
        return list(lanes.values())

    def _end(self, turn: _Turn) -> None:
        """Compare the last step and what the service sent when it was stopped.

        The log of a killed process may be torn: what it lacks at its end is no difference.
        """
        self._dispatcher.close(turn.sent[-1].t_ns if turn.sent else turn.now_ns)
        self._compare(turn, self._sent.take()[: len(turn.sent)])
        self.report.steps += 1

    # --- comparison ------------------------------------------------------------------------------

    def _compare(self, turn: _Turn, replayed: list[Entry]) -> None:
        for old, new in zip_longest(turn.sent, replayed):
            self.report.frames += 1
            if old is None:
                self._differ(new, "(frame)", "nothing", "sent")
            elif new is None:
                self._differ(old, "(frame)", "sent", "nothing")
            elif old.key != new.key:
                self._differ(old, "(frame)", old.key, new.key)
            elif old.payload != new.payload:
                self._compare_fields(old, new)

    def _compare_fields(self, old: Entry, new: Entry) -> None:
        try:
            recorded = self._codec.decode(old.key, old.payload)
        except Refused as error:
            self._differ(old, "(payload)", f"not a message ({error})", "a message")
            return
        replayed = self._codec.decode(new.key, new.payload)
        pairs = ((recorded.header, replayed.header), (recorded.message, replayed.message))
        for before, after in pairs:
            for item in dataclasses.fields(before):
                self._compare_field(old, item.name, getattr(before, item.name), getattr(after, item.name))

    def _compare_field(self, entry: Entry, name: str, old: Any, new: Any) -> None:
        if name in self._comparison.ignored or _same(old, new, self._comparison.tolerances.get(name, 0.0)):
            return
        self._differ(entry, name, *_shown(old, new))

    def _differ(self, entry: Entry, name: str, recorded: str, replayed: str) -> None:
        self.report.add(
            Difference(self.report.steps, entry.t_ns, entry.key, name, recorded[:200], replayed[:200])
        )


def _turns(entries: Iterable[Entry], heartbeat: str) -> Iterator[_Turn]:
    """Gather the entries of each step; heartbeats are the live runner's own and left out."""
    inputs: list[Entry] = []
    results: list[Entry] = []
    turn: _Turn | None = None
    for entry in entries:
        if entry.kind == "step":
            if turn is not None:
                yield turn
            turn = _Turn(entry.t_ns, _number(entry), inputs, results)
            inputs, results = [], []
        elif entry.kind == "out" and entry.key != heartbeat:
            if turn is None:
                raise ReplayError(f"the log begins with {entry.key} and not with a step: it is not whole")
            turn.sent.append(entry)
        elif entry.kind != "out":
            (inputs if entry.kind == "in" else results).append(entry)
    if turn is not None:
        yield turn


def _number(entry: Entry) -> int:
    """Ticks of a step, or the duration of a job in ns."""
    try:
        return int(struct.unpack("<q", entry.payload)[0])
    except struct.error:
        raise ReplayError(f"entry `{entry.kind} {entry.key}` holds no number") from None


def _same(old: Any, new: Any, tolerance: float) -> bool:
    """Equal, or at most `tolerance` apart in every number."""
    if isinstance(old, np.ndarray):
        before, after = _wide(old), _wide(new)
        return before.shape == after.shape and bool(np.all(np.abs(before - after) <= tolerance))
    if isinstance(old, dict):
        entries = cast(dict[str, Any], old)
        return entries.keys() == new.keys() and all(_same(entries[k], new[k], tolerance) for k in entries)
    if isinstance(old, float):
        return abs(old - new) <= tolerance
    return bool(old == new)


def _wide(array: Any) -> NDArray[np.float64]:
    return np.asarray(array, np.float64)


def _shown(old: Any, new: Any) -> tuple[str, str]:
    """Both values as text: of arrays where they differ most, of bytes how many there are."""
    if isinstance(old, np.ndarray):
        before, after = _wide(old), _wide(new)
        if before.shape != after.shape:
            return f"shape {before.shape}", f"shape {after.shape}"
        worst = np.unravel_index(int(np.argmax(np.abs(before - after))), before.shape)
        index = [int(i) for i in worst]
        return f"{index} {before[worst]:.9g}", f"{index} {after[worst]:.9g}"
    if isinstance(old, bytes):
        return f"{len(old)} bytes", f"{len(new)} other bytes"
    return repr(old), repr(new)

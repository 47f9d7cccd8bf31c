"""The viewer as a service: gathers samples and hands them to a worker that draws; it only listens."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from common.bus import Inbox, Input
from common.messages import Sample
from common.service import Job, Output, Report
from deploy.viewer.drawer import DRAWN


class Canvas(Protocol):
    """What the samples are drawn on; `open` and `draw` run in the worker."""

    @property
    def url(self) -> str:
        """Where to look; empty while nothing is served."""
        ...

    def open(self) -> None:
        """Get ready; may take long."""
        ...

    def draw(self, samples: Iterable[Sample]) -> None:
        """Draw samples in the order given; may take long."""
        ...

    def close(self) -> None:
        """Finish within a bounded time."""
        ...


class ViewerService:
    """One job at a time; what arrives meanwhile waits, and beyond `queue` the oldest is dropped."""

    name = "viewer"
    inputs = tuple(Input(topic) for topic in DRAWN)

    def __init__(self, canvas: Canvas, boot_id: int, period_ns: int, queue: int) -> None:
        self.boot_id = boot_id
        self.period_ns: int | None = period_ns
        self._canvas = canvas
        self._waiting: deque[Sample] = deque(maxlen=queue)
        self._opened = False
        self._busy = False
        self._drawn = 0
        self._dropped = 0
        self._failed = 0
        self._error = ""

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Take what came; give it to the worker if that is idle."""
        del now_ns
        self._gather(inbox)
        self._learn_results(inbox)
        if self._busy:
            return []
        if not self._opened:
            self._busy = self._opened = True
            return [Job("open", self._canvas.open)]
        if not self._waiting:
            return []
        self._busy = True
        return [Job("draw", self._canvas.draw, (self._take(),))]

    def _gather(self, inbox: Inbox) -> None:
        arrived = [sample for topic in DRAWN for sample in inbox.take(topic)]
        for sample in sorted(arrived, key=lambda sample: sample.header.t_ns):
            self._dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(sample)

    def _learn_results(self, inbox: Inbox) -> None:
        for result in inbox.results:
            self._busy = False
            if result.error:
                self._failed += 1
                self._error = f"{result.name}: {result.error}"

    def _take(self) -> list[Sample]:
        samples = list(self._waiting)
        self._waiting.clear()
        self._drawn += len(samples)
        return samples

    def stop(self, now_ns: int) -> list[Output]:
        """Finish the recording; what still waits is left out."""
        del now_ns
        self._canvas.close()
        return []

    def report(self) -> Report:
        """Say where the dashboard is, or what went wrong."""
        counts = {"drawn": self._drawn, "dropped": self._dropped, "failed": self._failed}
        state = self._error or (f"dashboard at {self._canvas.url}" if self._canvas.url else "recording")
        return Report(state, {name: float(value) for name, value in counts.items()})

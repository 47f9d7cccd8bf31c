"""What perception counts and times, for its heartbeat."""

# pyright: strict

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from common.service import Report
from services.perception.status import Said

WINDOW = 512  # pictures that quantiles are taken over
_NAMES = (
    "pictures",
    "skipped",
    "claimed",
    "unclaimed",
    "outliers",
    "jumps",
    "searches",
    "found",
    "resets",
    "failed_jobs",
    "refused_invalid",
)


class Counts:
    """Since the start of the process."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._last: int | None = None  # number of the newest picture
        self._solve_ms: deque[float] = deque(maxlen=WINDOW)
        self._latency_ms: deque[float] = deque(maxlen=WINDOW)

    def add(self, name: str, count: int = 1) -> None:
        """Count something."""
        self._counts[name] += count

    def arrived(self, number: int) -> None:
        """A picture came; numbers that were left out are pictures that nobody saw."""
        self._counts["pictures"] += 1
        if self._last is not None and number > self._last + 1:
            self._counts["skipped"] += number - self._last - 1
        self._last = number

    def solved(self, solve_ms: float, latency_ms: float) -> None:
        """A picture was worked on, `latency_ms` after it was taken."""
        self._solve_ms.append(solve_ms)
        self._latency_ms.append(latency_ms)

    def fields(self) -> dict[str, float]:
        """Counts, and quantiles over the last pictures."""
        fields = {name: float(self._counts[name]) for name in _NAMES}
        for name, times in (("solve_ms", self._solve_ms), ("latency_ms", self._latency_ms)):
            p50, p95 = np.percentile(times, (50, 95)) if times else (0.0, 0.0)
            fields |= {f"{name}_p50": float(p50), f"{name}_p95": float(p95)}
        return fields


def report(said: Said, fields: dict[str, float], camera: Report) -> Report:
    """What the heartbeat says: the state, what ails a camera of this machine, and all counts."""
    words = f"{said.state.value}: {said.message}" if said.message else said.state.value
    return Report(f"{words}; camera: {camera.state}" if camera.state else words, fields | camera.fields)

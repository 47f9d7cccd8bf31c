"""Clocks, and a ticker with absolute deadlines that skips missed ticks and never bursts to catch up."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """Nanoseconds since the epoch that never step back."""

    def now_ns(self) -> int:
        """Return the present time."""
        ...


class WallClock:
    """The epoch read once, advanced by the monotonic clock: a time-synchronisation step cannot disturb it."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the present time."""
        return self._offset_ns + time.monotonic_ns()


@dataclass
class VirtualClock:
    """Time that stands still until the lock-step runner moves it."""

    time_ns: int = 0

    def now_ns(self) -> int:
        """Return the present virtual time."""
        return self.time_ns


class Ticker:
    """Deadlines start, start + period, start + 2 period, ... of one loop."""

    def __init__(self, period_ns: int, start_ns: int) -> None:
        self.period_ns = period_ns
        self.next_ns = start_ns

    def take(self, now_ns: int) -> int:
        """Return how many deadlines have passed up to now (0: not due; above 1: ticks were missed)."""
        if now_ns < self.next_ns:
            return 0
        passed = 1 + (now_ns - self.next_ns) // self.period_ns
        self.next_ns += passed * self.period_ns
        return passed

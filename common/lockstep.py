"""The lock-step runner: several services in one process on a virtual clock, deterministic to the byte."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

from common.bus import JobResult
from common.clock import Ticker, VirtualClock
from common.runner import Dispatcher, run_job
from common.service import Job


@dataclass(order=True)
class _Finished:
    """A job that was computed at once and shows its result only at `t_ns`."""

    t_ns: int
    order: int
    dispatcher: Dispatcher = field(compare=False)
    result: JobResult = field(compare=False)


@dataclass
class _Member:
    dispatcher: Dispatcher
    ticker: Ticker | None
    lane_free_ns: dict[str, int] = field(default_factory=lambda: defaultdict[str, int](int))


class Lockstep:
    """Steps services in the order given, at ticks, on waking inputs and when declared latencies have passed.

    Messages arrive at the virtual time at which they are sent. Every duration is the declared one, so a run
    depends on the seed alone.
    """

    def __init__(self, dispatchers: list[Dispatcher], clock: VirtualClock) -> None:
        self.clock = clock
        self._members = [_Member(d, self._ticker(d)) for d in dispatchers]
        self._finished: list[_Finished] = []
        self._order = 0
        for dispatcher in dispatchers:
            dispatcher.open()

    def _ticker(self, dispatcher: Dispatcher) -> Ticker | None:
        period = dispatcher.service.period_ns
        return None if period is None else Ticker(period, self.clock.time_ns)

    def run(self, until: Callable[[], bool], limit_ns: int) -> bool:
        """Advance until `until()` holds (True), a service finishes (True) or `limit_ns` passes (False)."""
        while not until() and not any(m.dispatcher.finish for m in self._members):
            next_ns = self._next_ns()
            if next_ns is None or next_ns > limit_ns:
                return False
            self.clock.time_ns = max(next_ns, self.clock.time_ns)
            self._instant()
        return True

    def _next_ns(self) -> int | None:
        if any(m.dispatcher.inbox.wake.is_set() for m in self._members):
            return self.clock.time_ns
        times = [m.ticker.next_ns for m in self._members if m.ticker]
        times += [self._finished[0].t_ns] if self._finished else []
        return min(times, default=None)

    def _instant(self) -> None:
        """Step everyone who is due at the present time, once; wakes they cause are the next instant."""
        now = self.clock.time_ns
        while self._finished and self._finished[0].t_ns <= now:
            item = heapq.heappop(self._finished)
            item.dispatcher.inbox.finish(item.result)
        for member in self._members:
            ticks = member.ticker.take(now) if member.ticker else 0
            if ticks or member.dispatcher.inbox.wake.is_set():
                member.dispatcher.step(now, ticks, lambda job, m=member: self._start(m, job))

    def _start(self, member: _Member, job: Job) -> None:
        value, error = run_job(job)
        end = max(self.clock.time_ns, member.lane_free_ns[job.lane]) + job.latency_ns
        member.lane_free_ns[job.lane] = end
        self._order += 1
        result = JobResult(job.name, value, error, job.latency_ns)
        heapq.heappush(self._finished, _Finished(end, self._order, member.dispatcher, result))

    def close(self) -> None:
        """Let every service save and close."""
        for member in self._members:
            member.dispatcher.close(self.clock.time_ns)

"""The live runner: one service, a real bus, the wall clock, and a worker thread per lane of long work."""

from __future__ import annotations

import gc
import threading
import time
from collections import deque
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from common.bus import JobResult
from common.clock import Clock, Ticker
from common.messages import Health
from common.runner import Dispatcher, run_job
from common.service import Finish, Job, Publish
from common.topics import HEALTH

HEARTBEAT_NS = 500_000_000
LOOP_WINDOW = 512
SPIN_NS = 300_000  # the last stretch before a tick is spun: sleeping overshoots by about as much


class LiveRunner:
    """Runs one service until `stop` is set or the service finishes."""

    def __init__(self, dispatcher: Dispatcher, clock: Clock, config_hash: str) -> None:
        self._dispatcher = dispatcher
        self._clock = clock
        self._config_hash = config_hash
        self._version = _version()
        self._workers: dict[str, _Worker] = {}  # by lane
        self._loop_ms: deque[float] = deque(maxlen=LOOP_WINDOW)
        self._ticks = 0
        self._overruns = 0
        self._heartbeat = Ticker(HEARTBEAT_NS, clock.now_ns())
        period = dispatcher.service.period_ns
        self._ticker = None if period is None else Ticker(period, clock.now_ns())

    def run(self, stop: threading.Event) -> int:
        """Loop; returns the exit code. Everything is closed on the way out, also after an error."""
        self._dispatcher.open()
        gc.freeze()  # what imports made never dies; each look through it took 0.1 s: two control steps
        try:
            while not stop.is_set() and self._dispatcher.finish is None:
                self._turn()
        finally:
            self._close()
        finish: Finish | None = self._dispatcher.finish
        return finish.code if finish else 0

    def _turn(self) -> None:
        self._wait()
        now = self._clock.now_ns()
        ticks = self._ticker.take(now) if self._ticker else 0
        if ticks or self._dispatcher.inbox.wake.is_set():
            self._step(now, ticks)
        if self._heartbeat.take(now):
            self._dispatcher.publish(self._health(now), now)
            self._dispatcher.flush()

    def _wait(self) -> None:
        deadline = self._heartbeat.next_ns
        if self._ticker:
            deadline = min(deadline, self._ticker.next_ns)
        remaining = deadline - self._clock.now_ns()
        if remaining > SPIN_NS and self._dispatcher.inbox.wake.wait((remaining - SPIN_NS) / 1e9):
            return
        while self._clock.now_ns() < deadline and not self._dispatcher.inbox.wake.is_set():
            time.sleep(0)

    def _step(self, now: int, ticks: int) -> None:
        self._ticks += ticks
        self._overruns += max(0, ticks - 1)
        self._dispatcher.step(now, ticks, self._start_job)
        self._loop_ms.append((self._clock.now_ns() - now) / 1e6)

    def _start_job(self, job: Job) -> None:
        if job.lane not in self._workers:
            self._workers[job.lane] = _Worker(self._work, f"job {job.lane}")
        self._workers[job.lane].submit(job)

    def _work(self, job: Job) -> None:
        begin = self._clock.now_ns()
        value, error = run_job(job)
        self._dispatcher.inbox.finish(JobResult(job.name, value, error, self._clock.now_ns() - begin))

    def _health(self, now: int) -> Publish:
        inbox = self._dispatcher.inbox
        report = self._dispatcher.service.report()
        p50, p99 = np.percentile(self._loop_ms, (50, 99)) if self._loop_ms else (0.0, 0.0)
        log_failed = self._dispatcher.log_failed
        own = {"unsendable": float(self._dispatcher.unsendable), "log_failed": float(bool(log_failed))}
        health = Health(
            service=self._dispatcher.service.name,
            state=log_failed or report.state,
            loop_p50_ms=float(p50),
            loop_p99_ms=float(p99),
            ticks=self._ticks,
            overruns=self._overruns,
            stale_inputs=inbox.stale(now),
            refused=dict(inbox.refused),
            dropped=self._dispatcher.dropped,
            config_hash=self._config_hash,
            version=self._version,
            rss_mb=_rss_mb(),
            fields=report.fields | own,
        )
        return Publish(HEALTH, health, suffix=self._dispatcher.service.name)

    def _close(self) -> None:
        for worker in self._workers.values():
            worker.close()
        self._dispatcher.close(self._clock.now_ns())


class _Worker:
    """One thread that does jobs in their order; an executor's futures would cost a plan 0.1 ms of delay."""

    def __init__(self, work: Callable[[Job], None], name: str) -> None:
        self._work = work
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._closing = False
        # A job in progress is not waited for: what it would have saved is made again after a restart.
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def submit(self, job: Job) -> None:
        self._jobs.put(job)

    def close(self) -> None:
        """Do none of the jobs that still wait."""
        self._closing = True
        self._jobs.put(None)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None and not self._closing:
            self._work(job)


def _version() -> str:
    try:
        return version("gc-pmpc")
    except PackageNotFoundError:
        return "uninstalled"


def _rss_mb() -> float:
    """Resident memory of this process in MB (Linux; 0 elsewhere)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * 4096 / 1e6

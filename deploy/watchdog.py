"""Restarts, through supervisord, what exists but has been silent for seconds: a service like the others."""

from __future__ import annotations

import math
from collections import Counter
from typing import Protocol

from common.bus import Inbox, Input
from common.cell import SharedConfig
from common.process import Built, run_process
from common.service import Job, Output, Report
from common.topics import HEALTH
from deploy.processes import process_of
from deploy.supervisor_client import ProcessInfo, SupervisorClient
from deploy.watchdog_config import WatchdogConfig

PERIOD_NS = 500_000_000
ASLEEP_NS = 2_000_000_000  # a pause of our own this long proves nothing about the others
UPTIME_DOUBT_S = 1.5  # supervisord counts whole seconds; nobody speaks sooner after its start
QUIET_S = 2.0  # four heartbeats: when nobody at all is heard for so long, the bus itself is in doubt
ROUTER = "router"


class WatchdogProcess(SharedConfig):
    """What the watchdog's process reads."""

    watchdog: WatchdogConfig


class SupervisorPort(Protocol):
    """What the watchdog needs of supervisord; every call may raise SupervisorError."""

    def processes(self) -> dict[str, ProcessInfo]:
        """Return the state of each process by name."""
        ...

    def restart(self, name: str, patience_s: float) -> None:
        """Stop a process, by force after `patience_s`, and start it again."""
        ...


class Watchdog:
    """Listens to all heartbeats and has silent processes of its own machine restarted."""

    inputs: tuple[Input, ...] = (Input(HEALTH),)
    period_ns: int | None = PERIOD_NS

    def __init__(self, config: WatchdogConfig, supervisor: SupervisorPort, boot_id: int) -> None:
        self.name = config.name
        self.boot_id = boot_id
        self._config = config
        self._supervisor = supervisor
        self._heard_ns: dict[str, int] = {}
        self._last_step_ns: int | None = None
        self._looked_ns: dict[str, int] = {}
        self._asked = ""  # process that a job looks at now
        self._restarts: Counter[str] = Counter()
        self._errors = 0
        self._state = "starting"

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Note who was heard; return a job for a process that needs looking at, if any."""
        speakers = [sample.message.service for sample in inbox.take(HEALTH)]
        self._hear(now_ns, [name for name in speakers if name != self.name])
        for result in inbox.results:
            self._asked = ""
            self._errors += bool(result.error)
            self._restarts[result.name] += result.value is True
        suspects = self.suspects(now_ns)
        self._state = (
            f"silent: {', '.join(suspects)}" if suspects else f"watching {len(self._config.watches)}"
        )
        if self._asked or not suspects:
            return []  # one at a time: a job that had waited would judge by what is no longer true
        self._asked = min(suspects, key=lambda name: self._looked_ns.get(name, 0))  # in turn
        self._looked_ns[self._asked] = now_ns
        return [Job(self._asked, self._look_at, (self._asked, self._silent_s(self._asked, now_ns)))]

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing to save."""
        del now_ns
        return []

    def report(self) -> Report:
        """Tell who is silent and how often each process was restarted."""
        per_process = {f"restarts_{name}": float(count) for name, count in self._restarts.items() if count}
        total = float(self._restarts.total())
        return Report(
            self._state, {"restarts": total, "supervisor_errors": float(self._errors), **per_process}
        )

    def suspects(self, now_ns: int) -> tuple[str, ...]:
        """Name the watched processes that are silent and whose silence is their own fault.

        The router has no heartbeat: when nobody at all is heard, it alone is suspected, and nobody is if it
        runs on another machine. Heartbeats do not stop at one moment, so that well before it is silent for
        long enough nobody else is suspected either.
        """
        if not self._heard_ns:
            return ()  # the cell is only just starting
        silent = tuple(name for name in self._config.watches if self._is_silent(name, now_ns))
        if self._is_quiet(now_ns):
            return tuple(name for name in silent if name == ROUTER)
        return silent

    def _hear(self, now_ns: int, names: list[str]) -> None:
        """Note who spoke; silence that our own sleep or a broken bus explains is forgiven to everybody."""
        slept = self._last_step_ns is not None and now_ns - self._last_step_ns > ASLEEP_NS
        bus_is_back = self._is_quiet(now_ns) and bool(names)
        if slept or bus_is_back:
            self._heard_ns = dict.fromkeys(self._heard_ns, now_ns)
        self._heard_ns.update(dict.fromkeys(names, now_ns))
        self._last_step_ns = now_ns

    def _is_silent(self, name: str, now_ns: int) -> bool:
        return self._silent_s(name, now_ns) > self._config.silent_s

    def _is_quiet(self, now_ns: int) -> bool:
        return self._silent_s(ROUTER, now_ns) > min(QUIET_S, self._config.silent_s)

    def _silent_s(self, name: str, now_ns: int) -> float:
        """Seconds since `name` was heard, since anybody was for the router; infinite: never."""
        heard = self._heard_ns.values() if name == ROUTER else [self._heard_ns.get(name, -math.inf)]
        return (now_ns - max(heard, default=-math.inf)) / 1e9

    def _look_at(self, name: str, silent_s: float) -> bool:
        """Restart the process if it is frozen; returns whether it was. Runs as a job."""
        info = self._supervisor.processes().get(name)
        if info is None or not is_frozen(info, silent_s, process_of(name).start_deadline_s):
            return False
        self._supervisor.restart(name, self._config.patience_s)
        return True


def is_frozen(info: ProcessInfo, silent_s: float, start_deadline_s: float) -> bool:
    """Tell a frozen process from one that is gone, finished, or still starting.

    `silent_s` is infinite if it was never heard. A process that spoke since it was started is frozen; one
    that did not may still take until its deadline.
    """
    spoke = silent_s < info.uptime_s - UPTIME_DOUBT_S
    return info.alive and (spoke or info.uptime_s > start_deadline_s)


def _build(config: WatchdogProcess, boot_id: int) -> Built:
    return Built(Watchdog(config.watchdog, SupervisorClient(config.watchdog.socket), boot_id))


if __name__ == "__main__":
    run_process("watchdog", WatchdogProcess, _build)

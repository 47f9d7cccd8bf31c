"""A whole cell in one process: the services that run live, on a virtual clock, deterministic for a seed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import agents
from bench.agents import AgentCell, AgentModel
from bench.cost import Meter, MeteredDispatcher
from common.built import Built, codec_for
from common.bus import LocalBus
from common.buslog import BusLog
from common.clock import VirtualClock
from common.lockstep import Lockstep
from common.messages import Header, SnapshotMessage
from common.model.snapshot import Snapshot
from common.runner import Dispatcher
from common.service import Service
from common.topics import SNAPSHOT
from deploy import curriculum
from deploy.cell import Cell, process_config
from deploy.curriculum_config import CurriculumProcess
from services.learner import build as learner
from services.planner import build as planner
from services.sim import build as sim

# In the order in which they are stepped. The curriculum stands before the learner: an episode's result is on
# disk before the long work of learning from it begins.
SERVICES = ("sim", "planner", "curriculum", "learner")
WITHOUT_LEARNER = ("sim", "planner", "curriculum")
WITH_AGENT = ("sim", "curriculum", "agent")

FOREVER_NS = 2**62
STALLED_NS = 1800 * 10**9  # virtual time without a new step after which nothing is going to happen


class Stalled(Exception):  # noqa: N818 - reads as what happened
    """The run cannot go on; the message is what each service says of itself."""


@dataclass(frozen=True)
class LockstepRun:
    """An assembled cell."""

    lockstep: Lockstep
    dispatchers: tuple[Dispatcher, ...]
    meter: Meter

    @property
    def services(self) -> Mapping[str, Service]:
        """The services by name."""
        return {dispatcher.service.name: dispatcher.service for dispatcher in self.dispatchers}

    def drive(self, watch: Callable[[], None] = lambda: None) -> None:
        """Run until the curriculum has finished, calling `watch` often. Raises Stalled.

        Services and logs are closed on the way out, whatever ended the run.
        """
        guard = _Guard(self, watch)
        try:
            if not self.lockstep.run(guard.stalled, FOREVER_NS) or guard.given_up:
                raise Stalled(self.states())
        finally:
            self.lockstep.close()

    def states(self) -> str:
        """Return what each service says of itself and what it could not send, as one line."""
        said = ((d.service.name, d.last_error or d.service.report().state) for d in self.dispatchers)
        return "; ".join(f"{name}: {text}" for name, text in said)


class _Guard:
    """Ends a run in which virtual time passes and nothing else."""

    def __init__(self, run: LockstepRun, watch: Callable[[], None]) -> None:
        self._run = run
        self._watch = watch
        self._seen: tuple[float, ...] = ()
        self._since_ns = 0
        self.given_up = False

    def stalled(self) -> bool:
        """Look at the plant and the learner; True when neither has done anything since the last look."""
        self._watch()
        now_ns = self._run.lockstep.clock.time_ns
        if now_ns < self._since_ns + STALLED_NS and self._seen:
            return False
        seen = tuple(
            fields.get(name, 0.0)
            for fields in (service.report().fields for service in self._run.services.values())
            for name in ("episode", "k", "updates", "stored_episodes", "lost_episodes")
        )
        self.given_up = seen == self._seen
        self._seen, self._since_ns = seen, now_ns
        return self.given_up


def assemble(
    cell: Cell,
    names: Iterable[str] | None = None,
    *,
    labels: Mapping[str, Any] | None = None,
    log_dir: Path | None = None,
    snapshot: Snapshot | None = None,
    agent: AgentModel | None = None,
    start_ns: int = 0,
) -> LockstepRun:
    """Build the named services, by default all that the cell needs, on one bus and clock.

    `labels` stand in every row of episodes.jsonl, `log_dir` receives the bus log of each service, `snapshot`
    takes the learner's place, and `agent` acts without learning. Raises ConfigError if the run directory is
    another run's.
    """
    if names is None:
        names = WITH_AGENT if isinstance(cell, AgentCell) else SERVICES
    bus, codec = LocalBus(), codec_for(cell.task)
    if snapshot is not None:
        _publish(bus, codec_for(cell.task).encode, snapshot, boot_id(cell.seed, "learner"))
    dispatchers: list[Dispatcher] = []
    meter = Meter()
    for name in names:
        built = _build_agent(cell, agent) if name == "agent" else _build(cell, name, labels or {})
        log = None if log_dir is None else _log(cell, name, log_dir)
        dispatchers.append(MeteredDispatcher(meter, built.service, codec, bus, built.ports, log))
    run = Lockstep(dispatchers, VirtualClock(start_ns))
    for dispatcher in dispatchers:
        dispatcher.inbox.wake.set()  # a service without ticks has something to say at its start, too
    return LockstepRun(run, tuple(dispatchers), meter)


def boot_id(seed: int, name: str) -> int:
    """Return the boot id of a service in every run with this seed: a resumed run is the same run."""
    return 1 + int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:7], "little")


def _build(cell: Cell, name: str, labels: Mapping[str, Any]) -> Built:
    data, boot = process_config(cell, name), boot_id(cell.seed, name)
    if name == "sim":
        return sim.build(sim.SimProcess.model_validate(data), boot)
    if name == "planner":
        return planner.build(planner.PlannerProcess.model_validate(data), boot)
    if name == "learner":
        return learner.build(learner.LearnerProcess.model_validate(data), boot)
    return curriculum.build(CurriculumProcess.model_validate(data), boot, labels)


def _build_agent(cell: Cell, agent: AgentModel | None) -> Built:
    assert isinstance(cell, AgentCell)
    return agents.build(cell, boot_id(cell.seed, "agent"), agent)


def _log(cell: Cell, name: str, directory: Path) -> BusLog:
    megabyte = 1_000_000
    segment, keep = round(cell.log.segment_mb * megabyte), round(cell.log.keep_mb * megabyte)
    return BusLog(directory, name, boot_id(cell.seed, name), segment, keep)


def _publish(
    bus: LocalBus, encode: Callable[[Header, SnapshotMessage], bytes], snapshot: Snapshot, boot: int
) -> None:
    message = SnapshotMessage(snapshot.id, snapshot.meta.episodes, snapshot.to_bytes())
    bus.publish(SNAPSHOT, SNAPSHOT.key, encode(Header(boot, 0, 0, True), message))

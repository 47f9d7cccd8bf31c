"""A learner's snapshots without its work: `python -m bench.loop_snapshots --config FILE` repeats one."""

from __future__ import annotations

import torch
from pydantic import Field

from common.built import Built
from common.bus import Inbox, Input
from common.cell import SharedConfig
from common.messages import SnapshotMessage
from common.model.choose import coordinates_of
from common.model.config import ModelConfig
from common.model.dynamics import Dynamics
from common.model.masks import MaskPool
from common.model.normaliser import Normaliser
from common.model.snapshot import Snapshot, SnapshotMeta
from common.process import run_process
from common.service import Output, Publish, Report
from common.task import Task, get_task
from common.topics import SNAPSHOT


class SnapshotsProcess(SharedConfig):
    """What this process is started with."""

    model: ModelConfig = ModelConfig()
    snapshot_hz: float = Field(default=2.0, gt=0, description="how often the snapshot is published")


class SnapshotSource:
    """Publishes the same snapshot at a fixed rate."""

    name = "snapshots"
    inputs: tuple[Input, ...] = ()

    def __init__(self, message: SnapshotMessage, rate_hz: float, boot_id: int) -> None:
        self.boot_id = boot_id
        self.period_ns: int | None = round(1e9 / rate_hz)
        self._message = message
        self._published = 0

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Publish when it is time to."""
        if not inbox.ticks:
            return []
        self._published += 1
        return [Publish(SNAPSHOT, self._message)]

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving."""
        return []

    def report(self) -> Report:
        """How much was published."""
        megabytes = len(self._message.payload) / 1e6
        return Report("publishing", {"published": float(self._published), "snapshot_mb": megabytes})


def untrained_snapshot(model: ModelConfig, task: Task, seed: int = 0) -> Snapshot:
    """A valid snapshot for the task: networks as they are drawn, identity normaliser."""
    generator = torch.Generator().manual_seed(seed)
    coordinates = coordinates_of(model.coordinates, task)
    identity = Normaliser.identity(coordinates.inputs, coordinates.changes)
    dynamics = Dynamics.create(model, identity, coordinates, generator)
    masks = MaskPool.draw(model.members, model.plan_masks, model.hidden, model.dropout, generator)
    meta = SnapshotMeta(
        task=task.name,
        state_dim=task.state_dim,
        action_dim=task.action_dim,
        inputs=coordinates.inputs,
        changes=coordinates.changes,
        counter=0,
        episodes=0,
        model=model,
    )
    return Snapshot.of(dynamics, masks, meta)


def build(config: SnapshotsProcess, boot_id: int) -> Built:
    """Make the snapshot once, and the service that repeats it."""
    torch.set_num_threads(1)
    snapshot = untrained_snapshot(config.model, get_task(config.task), config.seed)
    message = SnapshotMessage(snapshot.id, snapshot.meta.episodes, snapshot.to_bytes())
    return Built(SnapshotSource(message, config.snapshot_hz, boot_id))


if __name__ == "__main__":
    run_process("snapshots", SnapshotsProcess, build, nice=5)

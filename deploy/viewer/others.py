"""Draws what is not tied to a control step: episodes asked for, model updates, and heartbeats."""

from __future__ import annotations

from collections.abc import Iterator

from common.messages import Episode, Health, Metrics, Mode
from common.task import Task
from deploy.viewer.curves import MM
from deploy.viewer.drawing import Drawing, When, event, scalars


def draw_episode(message: Episode, when: When) -> Iterator[Drawing]:
    """What the curriculum asks for."""
    if message.mode is Mode.IDLE:
        yield event("curriculum", when, "nothing more to do")
        return
    text = f"wants episode {message.episode}: {message.mode}, {message.steps} steps, seed {message.seed}"
    yield event("curriculum", when, text if not message.goal_seq else f"{text}, goal {message.goal_seq}")


def draw_metrics(task: Task, message: Metrics, when: When) -> Iterator[Drawing]:
    """Losses, hold-out errors (positions in mm) and calibration after an update."""
    for name, value in message.loss.items():
        yield scalars(f"learning/loss/{name}", when, value)
    for name, value in message.calibration.items():
        yield scalars(f"learning/calibration/{name}", when, value)
    for name, value in message.holdout.items():
        group, _, horizon = name.rpartition("_h")
        path, scale = holdout_path(task, group)
        yield scalars(f"{path}/h{horizon}", when, scale * value)
    yield scalars("learning/update_s", when, message.update_ms / 1e3)
    seen = f"{message.episodes} episodes, {message.steps} steps"
    yield event("learner", when, f"model {message.snapshot_id}: {seen}, {message.update_ms / 1e3:.1f} s")


def holdout_path(task: Task, group_name: str) -> tuple[str, float]:
    """Where a group's hold-out errors are drawn, its unit in the name, and what they are multiplied by."""
    unit = next((group.unit for group in task.groups if group.name == group_name), "")
    if unit == "m":
        return f"learning/holdout/{group_name}_mm", MM
    suffix = {"": "", "1": ""}.get(unit, "_" + unit.replace("/", "_per_"))
    return f"learning/holdout/{group_name}{suffix}", 1.0


class HealthDrawer:
    """Turns heartbeats into curves, and into events where something has changed."""

    def __init__(self) -> None:
        self._stale: dict[str, tuple[str, ...]] = {}
        self._hashes: dict[str, str] = {}

    def draw(self, message: Health, when: When) -> Iterator[Drawing]:
        """Loop time, memory, what was lost, and the service's own counters."""
        name = message.service
        lost = sum(message.refused.values()) + sum(message.dropped.values())
        yield scalars(f"health/loop_p99_ms/{name}", when, message.loop_p99_ms)
        yield scalars(f"health/rss_mb/{name}", when, message.rss_mb)
        yield scalars(f"health/lost/{name}", when, lost + message.overruns)
        for field, value in message.fields.items():
            yield scalars(f"health/fields/{name}/{field}", when, value)
        yield from self._changes(message, when)

    def _changes(self, message: Health, when: When) -> Iterator[Drawing]:
        name = message.service
        if self._hashes.get(name) != message.config_hash:
            self._hashes[name] = message.config_hash
            yield event(
                name, when, f"{message.state} (version {message.version}, config {message.config_hash})"
            )
        if self._stale.get(name, ()) != message.stale_inputs:
            missing = ", ".join(message.stale_inputs)
            yield event(name, when, f"no fresh {missing}" if missing else "all inputs fresh", _level(missing))
        self._stale[name] = message.stale_inputs


def _level(missing: str) -> str:
    return "WARN" if missing else "INFO"

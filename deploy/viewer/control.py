"""Draws the control loop: hand, goal, actions, plans and their timing, predictions, and how episodes end."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from common.messages import Chunk, Fallback, Float32, Header, Step
from common.task import DieTask, ReachTask
from deploy.viewer.curves import (
    BAND_DEVIATIONS,
    FINGER_RGB,
    TO_GOAL,
    goal_errors,
    headline,
    shown_joints,
    watched_of,
)
from deploy.viewer.drawing import Drawing, Poses, Segments, State, When, event, scalars
from deploy.viewer.steps import StepCounter
from services.sim.kinematics import SceneKinematics

KEPT = 256  # chunks, and predictions that wait for their step
MIN_DEVIATION = 1e-6
GHOST = "ghost/"  # prefix of the predicted hand's frames


@dataclass
class _Episode:
    """What has been seen of the episode under way."""

    key: tuple[int, int]
    start_ns: int = 0  # when the plant began to move
    last_k: int = -1
    total_reward: float = 0.0
    goal_seq: int = 0
    source: str = ""
    dropped: bool = False


class ControlDrawer:
    """Turns `control/step` and `control/chunk` into drawings."""

    def __init__(self, kinematics: SceneKinematics, steps: StepCounter, period_ns: int, ghost: bool) -> None:
        self._kinematics = kinematics
        self._task = kinematics.task
        self._steps = steps
        self._period_ns = period_ns
        self._ghost = ghost
        self._watched = watched_of(self._task)
        self._shown = [self._task.actuator_names.index(name) for name in shown_joints(self._task)]
        self._chunks: OrderedDict[int, Chunk] = OrderedDict()  # by seq
        self._predicted: OrderedDict[int, Chunk] = OrderedDict()  # by step of the common axis
        self._episode = _Episode((0, -1))
        self._late = self._held = self._relaxed = 0
        self._snapshot_id = ""

    def step(self, header: Header, message: Step) -> list[Drawing]:
        """Everything that one control step shows; nothing for a step that was seen before or only waits."""
        number = self._steps.step(header.boot_id, message.episode, message.k)
        if number is None or message.waiting:
            return []
        self._steps.advance(number)
        when = When(number, header.t_ns, message.episode)
        return [*self._begin(header, message, when), *self._step(message, when)]

    def _step(self, message: Step, when: When) -> Iterator[Drawing]:
        if message.k <= self._episode.last_k:
            return
        self._episode.last_k = message.k
        yield from self._scene(message, when)
        yield from goal_errors(self._task, message.state, message.goal, when)
        yield from self._compare(message, when)
        if message.k:
            self._episode.total_reward += float(self._task.reward(message.state, message.goal))
            yield from self._executed(message, when)
        yield from self._happened(message, when)
        if message.last:
            yield from self._end(message, when)

    def _begin(self, header: Header, message: Step, when: When) -> Iterator[Drawing]:
        key = (header.boot_id, message.episode)
        if key == self._episode.key:
            return
        self._episode = _Episode(key, header.t_ns, goal_seq=message.goal_seq)
        yield Drawing("state/mode", when, State(message.mode))
        wanted = f", face {self._task.face_of(message.goal)} up" if isinstance(self._task, DieTask) else ""
        yield event("plant", when, f"episode {message.episode} begins: {message.mode}{wanted}")

    def _scene(self, message: Step, when: When) -> Iterator[Drawing]:
        poses = Poses(*self._kinematics.bodies(message.state, message.goal))
        yield Drawing("world/hand", when, poses)
        if self._ghost and message.chunk_seq < 0:  # without a plan the ghost hides in the hand
            yield Drawing("world/ghost", when, self._ghost_poses(message.state))
        if isinstance(self._task, ReachTask):
            tips, goals = (x.reshape(-1, 3) for x in (self._task.achieved(message.state), message.goal))
            lines = np.stack([tips, goals], axis=1).astype(np.float64)
            yield Drawing(TO_GOAL, when, Segments(lines, FINGER_RGB))

    def _compare(self, message: Step, when: When) -> Iterator[Drawing]:
        """What came, beside what was predicted for this step, in the ensemble's own deviations."""
        for watched in self._watched:
            value = watched.scale * message.state[watched.index]
            yield scalars(f"{watched.path}/actual", when, value)
        chunk = self._predicted.pop(when.step, None)
        if chunk is None:
            return
        deviations = (message.state - chunk.predicted_state) / np.maximum(chunk.predicted_std, MIN_DEVIATION)
        groups = [np.sqrt(np.mean(deviations[group.slice] ** 2)) for group in self._task.groups]
        yield scalars("prediction/z", when, [*groups, 1.0])

    def _executed(self, message: Step, when: When) -> Iterator[Drawing]:
        """The action between the step before and this one, drawn where it began."""
        before = When(when.step - 1, when.t_ns - self._period_ns, when.episode)
        yield scalars("actions/executed", before, message.prev_action[self._shown])
        yield scalars("actions/all", before, message.prev_action)
        chunk = self._chunks.get(message.chunk_seq)
        if chunk is not None:
            # A plan does not age while the plant stands still and waits for it.
            source_ns = max(chunk.source_t_ns, self._episode.start_ns)
            yield scalars("timing/age_ms", before, (before.t_ns - source_ns) / 1e6)
            self._late += message.chunk_offset >= chunk.commit
        self._held += message.fallback is Fallback.HOLD
        self._relaxed += message.fallback is Fallback.RELAX
        yield scalars("timing/lost", when, [self._late, self._held, self._relaxed])

    def _happened(self, message: Step, when: When) -> Iterator[Drawing]:
        source = _source(message)
        if message.k and source != self._episode.source:
            self._episode.source = source
            yield Drawing("state/action", When(when.step - 1, when.t_ns, when.episode), State(source))
            if message.fallback in (Fallback.HOLD, Fallback.RELAX):
                yield event("plant", when, f"step {message.k}: no planned action left, {source}", "WARN")
        if message.goal_seq != self._episode.goal_seq:
            self._episode.goal_seq = message.goal_seq
            yield event("plant", when, f"step {message.k}: goal {message.goal_seq} of the episode")
        if message.dropped and not self._episode.dropped:
            self._episode.dropped = True
            yield event("plant", when, f"step {message.k}: object dropped", "WARN")

    def _end(self, message: Step, when: When) -> Iterator[Drawing]:
        error, unit = headline(self._task, message.state, message.goal)
        success = bool(self._task.successes(message.state, message.goal)["success_paper"])
        yield scalars(f"episodes/return/{message.mode}", when, self._episode.total_reward)
        yield scalars(f"episodes/final_error/{message.mode}", when, error)
        verdict = "success" if success else "goal not reached"
        text = f"episode {message.episode} ends: {verdict}, {error:.3g} {unit}"
        yield event("plant", when, f"{text}, return {self._episode.total_reward:.3g}")

    def chunk(self, header: Header, message: Chunk) -> list[Drawing]:
        """The plan's committed actions, its cost in time, and the state that it expects."""
        first = self._steps.planned(message.plant_boot_id, message.episode, message.first_k)
        if first is None:
            return []
        _keep(self._chunks, header.seq, message)
        return [
            *self._plan(message, first),
            *self._expect(message, first),
            *self._model(message, header.t_ns),
        ]

    def _plan(self, message: Chunk, first: int) -> Iterator[Drawing]:
        budget_ms = message.commit * self._period_ns / 1e6
        source = self._at(message, message.source_k, first)
        yield scalars("timing/plan_ms", source, [message.solve_ms, budget_ms])
        for offset, action in enumerate(message.actions[: message.commit]):
            when = self._at(message, message.first_k + offset, first)
            yield scalars("actions/planned", when, action[self._shown])

    def _expect(self, message: Chunk, first: int) -> Iterator[Drawing]:
        when = self._at(message, message.predicted_k, first)
        _keep(self._predicted, when.step, message)
        for watched in self._watched:
            mean = watched.scale * message.predicted_state[watched.index]
            band = BAND_DEVIATIONS * watched.scale * message.predicted_std[watched.index]
            yield scalars(f"{watched.path}/predicted", when, [mean, mean + band, mean - band])
        if self._ghost:
            yield Drawing("world/ghost", when, self._ghost_poses(message.predicted_state))

    def _ghost_poses(self, state: Float32) -> Poses:
        no_goal = np.zeros(self._task.goal_dim)
        frames, positions, quaternions = self._kinematics.bodies(state, no_goal)
        shown = [i for i, frame in enumerate(frames) if not frame.startswith("goal")]
        return Poses(tuple(GHOST + frames[i] for i in shown), positions[shown], quaternions[shown])

    def _model(self, message: Chunk, t_ns: int) -> Iterator[Drawing]:
        if message.snapshot_id != self._snapshot_id:
            self._snapshot_id = message.snapshot_id
            yield event("planner", self._steps.now(t_ns), f"plans with model {message.snapshot_id}")

    def _at(self, message: Chunk, k: int, first: int) -> When:
        """Step k of the chunk's episode, at the time at which the plant reaches it."""
        t_ns = message.source_t_ns + (k - message.source_k) * self._period_ns
        return When(first - message.first_k + k, t_ns, message.episode)


def _source(message: Step) -> str:
    if message.fallback is not Fallback.NONE:
        return message.fallback
    return "plan" if message.chunk_seq >= 0 else message.mode


def _keep(kept: OrderedDict[int, Chunk], key: int, chunk: Chunk) -> None:
    kept[key] = chunk
    while len(kept) > KEPT:
        kept.popitem(last=False)

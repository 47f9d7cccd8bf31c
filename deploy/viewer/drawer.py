"""Messages → drawings: the one mapping behind the live dashboard and recordings made from bus logs."""

from __future__ import annotations

from collections.abc import Iterable

from common.hand_messages import HandJoints
from common.messages import Chunk, Episode, Health, Message, Metrics, Sample, Step
from common.topics import (
    CAMERA_PREVIEW,
    CHUNK,
    EPISODE,
    HAND_JOINTS,
    HEALTH,
    METRICS,
    OBJECT_POSE,
    POSE_TRACKING,
    STEP,
    TWIN_TRUTH,
    Topic,
)
from deploy.viewer.control import ControlDrawer
from deploy.viewer.drawing import Drawing, When
from deploy.viewer.hand import HandDrawer
from deploy.viewer.others import HealthDrawer, draw_episode, draw_metrics
from deploy.viewer.perception import PerceptionDrawer
from deploy.viewer.steps import StepCounter
from services.sim.kinematics import SceneKinematics

DRAWN: tuple[Topic, ...] = (
    EPISODE,
    CHUNK,
    METRICS,
    STEP,
    HEALTH,
    HAND_JOINTS,
    CAMERA_PREVIEW,
    POSE_TRACKING,
    OBJECT_POSE,
    TWIN_TRUTH,
)


class Drawer:
    """Turns samples, in about the order in which they were sent, into drawings."""

    def __init__(self, kinematics: SceneKinematics, period_ns: int, ghost: bool) -> None:
        self._task = kinematics.task
        self._steps = StepCounter()
        self._control = ControlDrawer(kinematics, self._steps, period_ns, ghost)
        self._health = HealthDrawer()
        self._hand = HandDrawer(self._task)
        self._perception = PerceptionDrawer()

    def draw(self, sample: Sample) -> list[Drawing]:
        """What a sample shows; nothing for messages that are not drawn."""
        now = self._steps.now(sample.header.t_ns)
        match sample.message:
            case Step() as step:
                drawings = self._control.step(sample.header, step)
                shown = self._hand.step(step, self._steps.now(sample.header.t_ns)) if drawings else ()
                return [*drawings, *shown]
            case Chunk() as chunk:
                return self._control.chunk(sample.header, chunk)
            case Episode() as episode:
                return list(draw_episode(episode, now))
            case Metrics() as metrics:
                return list(draw_metrics(self._task, metrics, now))
            case _:
                return list(self._draw_state(sample, now))

    def _draw_state(self, sample: Sample, now: When) -> Iterable[Drawing]:
        """What services and hardware say of themselves."""
        message: Message = sample.message
        if isinstance(message, Health):
            return self._health.draw(message, now)
        if isinstance(message, HandJoints):
            return self._hand.draw(message, now)
        return self._perception.draw(sample, now)

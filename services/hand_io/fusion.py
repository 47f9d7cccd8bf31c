"""One state out of what boards and pose source last said, with validity and age for each part."""

# pyright: strict

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.angles import to_normalised
from common.dexhand021.tables import BOARDS, MOTORS
from common.geometry import normalise
from common.hand_messages import HandFrame, ObjectPose, PoseSource
from common.message_fields import Float32
from common.messages import Header
from common.plant_loop import Seen
from common.task import Task

NS_PER_MS = 1e6
OLDEST_MS = 1e6
_TIPS = [i for i, board in enumerate(BOARDS) if board.has_tactile]
_UNSEEN = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], np.float32)  # a pose that is at least a rotation

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class Freshness:
    """What counts as valid."""

    hand_ms: float
    pose_ms: float
    pose_quality: float
    pose_source: PoseSource


class Fusion:
    """Builds states (24,): 12 joint angles (rad), 5 normal forces (N), the die's pose in the palm frame.

    What is not valid keeps its last valid value, so that a state is always finite and plausible.
    """

    def __init__(self, task: Task, fresh: Freshness) -> None:
        self._groups = task.groups
        self._task = task
        self._fresh = fresh
        self._state = np.concatenate([np.zeros(MOTORS + len(_TIPS), np.float32), _UNSEEN])
        self._accepted_ns = 0  # when the newest accepted pose was seen
        self.refused: Counter[str] = Counter()  # poses of the die, by reason

    def accepts(self, now_ns: int, header: Header, told: ObjectPose) -> bool:
        """Whether a pose may be used; one that is refused is counted, and the one before stays in use."""
        reason = self._objection(now_ns, header, told)
        if reason:
            self.refused[reason] += 1
        else:
            self._accepted_ns = header.t_ns
        return not reason

    def _objection(self, now_ns: int, header: Header, told: ObjectPose) -> str:
        if told.source is not self._fresh.pose_source:
            return "source"
        if not header.valid:
            return "unclaimed"
        if header.t_ns > now_ns + self._fresh.pose_ms * NS_PER_MS:
            return "future"  # by a clock that is ahead: it would count as fresh long after its sender is gone
        if header.t_ns < self._accepted_ns:
            return "late"
        good = told.quality >= self._fresh.pose_quality and bool(np.linalg.norm(told.rotation) > 0.5)
        return "" if good else "quality"

    def see(
        self, now_ns: int, frame: HandFrame, pose: tuple[Header, ObjectPose] | None, goal: Float32
    ) -> Seen:
        """What the hand shows at `now_ns`; `pose`: the newest accepted one; `goal` (7,) is passed on."""
        age_ms, valid = self._hand(now_ns, frame)
        pose_age_ms, pose_valid = self._pose(now_ns, pose)
        ages = np.concatenate([age_ms, np.full(7, pose_age_ms)])
        valids = np.concatenate([valid, np.full(7, pose_valid)])
        fresh = self._values(frame, pose)
        self._state = np.where(valids, fresh, self._state).astype(np.float32)
        return Seen(
            state=self._state,
            part_valid=np.array([valids[group.slice].all() for group in self._groups], np.uint8),
            part_age_ms=np.array([ages[group.slice].max() for group in self._groups], np.float32),
            goal=goal,
            dropped=bool(self._task.dropped(self._state)),
            executed=executed(frame),
        )

    def _values(self, frame: HandFrame, pose: tuple[Header, ObjectPose] | None) -> Float32:
        if pose is None:
            return np.concatenate([frame.angle_rad, frame.force_n, _UNSEEN])
        rotation = normalise(pose[1].rotation)
        return np.concatenate([frame.angle_rad, frame.force_n, pose[1].position, rotation])

    def _hand(self, now_ns: int, frame: HandFrame) -> tuple[NDArray[np.float64], Bool]:
        """Age and validity of 12 angles and 5 forces: (17,) each."""
        boards_ms = frame.age_ms.astype(np.float64) + max(0, now_ns - frame.t_ns) / NS_PER_MS
        age_ms = np.minimum(np.concatenate([np.repeat(boards_ms, 2), boards_ms[_TIPS]]), OLDEST_MS)
        said = np.concatenate([np.ones(MOTORS), frame.force_valid]).astype(np.bool_)
        return age_ms, said & (age_ms <= self._fresh.hand_ms)

    def _pose(self, now_ns: int, pose: tuple[Header, ObjectPose] | None) -> tuple[float, bool]:
        if pose is None:
            return OLDEST_MS, False
        age_ms = min(max(0, now_ns - pose[0].t_ns) / NS_PER_MS, OLDEST_MS)
        return age_ms, age_ms <= self._fresh.pose_ms


def executed(frame: HandFrame) -> Float32 | None:
    """The action (12,) that was carried out where limits made it another than the one asked for; else NaN."""
    if not frame.limited.any():
        return None
    carried_out = np.clip(to_normalised(frame.target_rad), -1.0, 1.0)
    return np.where(frame.limited, carried_out, np.nan).astype(np.float32)

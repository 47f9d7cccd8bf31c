"""The goals that a curriculum names itself, where the paper does: the faces of the die, one after another."""

from __future__ import annotations

import numpy as np

from common.messages import Float32, Mode
from common.task import DieTask, Task
from deploy.curriculum_config import CurriculumConfig
from deploy.schedule import Assignment


def goal_of(task: Task, assigned: Assignment, plan: CurriculumConfig) -> Float32:
    """The goal (G,) of an episode; empty where the plant shall draw it from the episode's seed.

    # Paper: the next face comes after "mastering" the one before (Sec. II-B), which is not defined; here each
    # has an equal share of the training episodes. Held-out goals take turns, the same in every evaluation.
    """
    faces = plan.goal_faces
    if not isinstance(task, DieTask) or not faces or assigned.mode not in (Mode.PLAN, Mode.EVALUATE):
        return np.zeros(0, np.float32)
    if assigned.mode is Mode.EVALUATE:
        return task.goal(faces[assigned.index % len(faces)]).astype(np.float32)
    share = assigned.index * len(faces) // max(1, plan.episodes)
    return task.goal(faces[min(share, len(faces) - 1)]).astype(np.float32)

"""The tasks, each one definition for numpy and torch, for planner, learner, plant and evaluation alike."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from common.dexhand021.tables import Hand
from common.task.die import DIE_GROUPS, TASK_OF, DieTask
from common.task.layout import OBJECT_GROUPS, REACH_GROUPS, Group
from common.task.manipulate import ManipulateTask
from common.task.reach import ReachTask
from common.task.task import Task

__all__ = ["TASKS", "DieTask", "Group", "ManipulateTask", "ReachTask", "Task", "get_die_task", "get_task"]

_DIE = DieTask("die", DIE_GROUPS, goal_dim=7)

TASKS: Mapping[str, Task] = MappingProxyType(
    {
        task.name: task
        for task in (
            ReachTask("reach", REACH_GROUPS, goal_dim=15),
            ManipulateTask("egg", OBJECT_GROUPS, goal_dim=7, position_counts=True),
            ManipulateTask("egg_rotate", OBJECT_GROUPS, goal_dim=7),
            ManipulateTask("block", OBJECT_GROUPS, goal_dim=7),
            _DIE,
            _DIE.mirrored(),
        )
    }
)


def get_task(name: str) -> Task:
    """The task called `name`. Raises ValueError naming those that there are."""
    if name not in TASKS:
        raise ValueError(f"no task {name!r}; choose one of {', '.join(TASKS)}")
    return TASKS[name]


def get_die_task(name: str, hand: Hand) -> DieTask:
    """The task called `name`, if it is the one for this DexHand. Raises ValueError naming the one that is."""
    task = get_task(name)
    if not isinstance(task, DieTask) or task.hand is not hand:
        raise ValueError(f"task: {name} is none for the DexHand 021 ({hand}); it has: {TASK_OF[hand]}")
    return task

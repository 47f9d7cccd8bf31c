"""The tasks, each one definition for numpy and torch, for planner, learner, plant and evaluation alike."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from common.task.die import DIE_GROUPS, DieTask
from common.task.layout import OBJECT_GROUPS, REACH_GROUPS, Group
from common.task.manipulate import ManipulateTask
from common.task.reach import ReachTask
from common.task.task import Task

__all__ = ["TASKS", "DieTask", "Group", "ManipulateTask", "ReachTask", "Task", "get_task"]

TASKS: Mapping[str, Task] = MappingProxyType(
    {
        task.name: task
        for task in (
            ReachTask("reach", REACH_GROUPS, goal_dim=15),
            ManipulateTask("egg", OBJECT_GROUPS, goal_dim=7, position_counts=True),
            ManipulateTask("egg_rotate", OBJECT_GROUPS, goal_dim=7),
            ManipulateTask("block", OBJECT_GROUPS, goal_dim=7),
            DieTask("die", DIE_GROUPS, goal_dim=7),
        )
    }
)


def get_task(name: str) -> Task:
    """The task called `name`. Raises ValueError naming those that there are."""
    if name not in TASKS:
        raise ValueError(f"no task {name!r}; choose one of {', '.join(TASKS)}")
    return TASKS[name]

"""Episodes end to end in memory, and windows of consecutive steps that never cross from one to the next.

Letters: W steps of a window, N windows, S state, A action, G goal.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bench.baselines.controller import Trajectory
from common.task import Task


class Windows(NamedTuple):
    """N runs of W steps: states[t] → actions[t] → states[t + 1], which earned rewards[t]."""

    states: Tensor  # (W + 1, N, S)
    actions: Tensor  # (W, N, A)
    rewards: Tensor  # (W, N, 1)
    goal: Tensor  # (N, G)


class Replay:
    """Windows are numbered from 0 in order of arrival, so that a method can keep a priority for each."""

    def __init__(self, task: Task, steps: int) -> None:
        """`steps` is W."""
        self._offsets = torch.arange(steps + 1)[:, None]
        self._states = _Rows(task.state_dim)
        self._actions = _Rows(task.action_dim)
        self._rewards = _Rows(1)
        self._goals = _Rows(task.goal_dim)
        self._first = _Rows(1, torch.int64)  # row of each window's first state

    def __len__(self) -> int:
        """How many windows there are."""
        return len(self._first)

    @property
    def states(self) -> Tensor:
        """All states, (rows, S)."""
        return self._states.tensor

    def add(self, trajectory: Trajectory) -> int:
        """Append an episode; returns how many windows it has. The row after its last step has no action."""
        length, first = len(trajectory.actions), len(self._states)
        self._states.extend(torch.as_tensor(trajectory.states))
        self._actions.extend(_padded(torch.as_tensor(trajectory.actions)))
        self._rewards.extend(_padded(torch.as_tensor(trajectory.rewards)[:, None]))
        self._goals.extend(torch.as_tensor(trajectory.goal).expand(length + 1, -1))
        windows = max(0, length - len(self._offsets) + 2)
        self._first.extend(torch.arange(first, first + windows)[:, None])
        return windows

    def windows(self, numbers: Tensor) -> Windows:
        """The windows with these numbers (N,)."""
        rows = self._first.tensor[numbers, 0] + self._offsets
        return Windows(
            states=self._states.tensor[rows],
            actions=self._actions.tensor[rows[:-1]],
            rewards=self._rewards.tensor[rows[:-1]],
            goal=self._goals.tensor[rows[0]],
        )


class Priorities:
    """A priority for each window; a new one gets the largest so far, 1 if there is none."""

    def __init__(self) -> None:
        self.values = torch.zeros(0)
        self.largest = 1.0

    def add(self, count: int) -> None:
        """`count` new windows."""
        self.values = torch.cat((self.values, torch.full((count,), self.largest)))

    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        """Numbers (count,) of windows, drawn in proportion to their priorities, with replacement."""
        total = self.values.cumsum(0)
        drawn = torch.rand(count, generator=generator) * total[-1]
        return torch.searchsorted(total, drawn).clamp_max(len(total) - 1)

    def update(self, numbers: Tensor, values: Tensor) -> None:
        """Give the windows `numbers` (N,) the priorities `values` (N,)."""
        self.values[numbers] = values
        self.largest = max(self.largest, float(values.max()))

    def forget_largest(self) -> None:
        """Count only priorities that a window still has."""
        self.largest = float(self.values.max())


def _padded(rows: Tensor) -> Tensor:
    return torch.cat((rows, torch.zeros_like(rows[:1])))


class _Rows:
    """A (rows, width) tensor that doubles its room when it is full."""

    def __init__(self, width: int, dtype: torch.dtype = torch.float32) -> None:
        self._data = torch.empty((1024, width), dtype=dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def tensor(self) -> Tensor:
        return self._data[: self._count]

    def extend(self, rows: Tensor) -> None:
        needed = self._count + len(rows)
        if needed > len(self._data):
            larger = torch.empty((max(needed, 2 * len(self._data)), rows.shape[1]), dtype=self._data.dtype)
            larger[: self._count] = self.tensor
            self._data = larger
        self._data[self._count : needed] = rows
        self._count = needed

"""What a simulated hand offers to its port, to viewers and to benches, whichever hand it is."""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.task import Task

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlantState:
    """State (S,) and goal (G,), float64, in the task's layout."""

    state: Floats
    goal: Floats


@dataclass(frozen=True)
class Snapshot:
    """All that determines the plant's future: MuJoCo's integration state (P,) and what was observed."""

    physics: Floats
    observed: PlantState


class Plant(Protocol):
    """A simulated hand with a task: same seed and actions, same states, bit for bit."""

    model: Any  # MuJoCo's
    data: Any

    @property
    def task(self) -> Task:
        """What the hand is to do."""
        ...

    @property
    def goal(self) -> Floats:
        """The current goal (G,)."""
        ...

    @property
    def state(self) -> Floats:
        """The state (S,) after the last reset, step or restore."""
        ...

    def reset(self, seed: int, goal: ArrayLike | None = None) -> PlantState:
        """Start the episode of `seed`, towards its own goal or `goal` (G,) if given."""
        ...

    def step(self, action: ArrayLike) -> Floats:
        """Execute `action` (A,), clipped to [-1, 1], for one control step; the state (S,) after it."""
        ...

    def set_goal(self, goal: ArrayLike) -> None:
        """Pursue `goal` (G,) from now on."""
        ...

    def sample_goal(self, seed: int) -> Floats:
        """The goal (G,) that `reset(seed)` would set; the running episode is not disturbed."""
        ...

    def save(self) -> Snapshot:
        """Everything needed to continue exactly from here."""
        ...

    def restore(self, snapshot: Snapshot) -> PlantState:
        """Continue exactly from `snapshot`."""
        ...

    def qpos(self, state: Floats) -> Floats:
        """The model's coordinates (nq,) that a state (S,), observed or predicted, describes."""
        ...

    def bodies(self) -> tuple[tuple[str, ...], Floats, Floats]:
        """Names (n), positions (n, 3) m, quaternions wxyz (n, 4): bodies and goal markers, world frame."""
        ...

"""What a compared method is to the bench: it remembers whole episodes, learns in slices, acts at each step.

Letters: T steps of an episode, S state, A action, G goal.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Float32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode; states[t] → actions[t] → states[t + 1], which earned rewards[t]. It never terminates."""

    states: Float32  # (T + 1, S)
    actions: Float32  # (T, A)
    rewards: Float32  # (T,), the environment's, of the states after each action
    goal: Float32  # (G,)
    planned: bool  # by the method itself; False: warm-up


class Controller(Protocol):
    """A method under comparison. What it does depends on its seeds and trajectories alone.

    All chance in `learn` and `act` comes from the seeds given, so a run that was interrupted comes to the
    same end: `remember` every trajectory again in order, then `restore`.
    """

    def remember(self, trajectory: Trajectory) -> None:
        """Add an episode to the replay, without learning from it yet."""
        ...

    def learn(self, updates: int, seed: int) -> dict[str, float]:
        """Take `updates` gradient steps; returns what the last one's losses were, by name."""
        ...

    def begin(self, seed: int, explore: bool) -> None:
        """An episode starts; `explore` is False in evaluations."""
        ...

    def act(self, state: Float32, goal: Float32) -> Float32:
        """Choose the action (A,) in [-1, 1] for state (S,) and goal (G,)."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """Everything that was learned, without the replay."""
        ...

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Continue where `tensors` was taken. Raises KeyError or RuntimeError on another method's."""
        ...


def derived_seed(*parts: int | str) -> int:
    """Return a seed below 2³² that depends on every part; the same on every machine."""
    words = [zlib.crc32(part.encode()) if isinstance(part, str) else part for part in parts]
    return int(np.random.SeedSequence(words).generate_state(1)[0])

"""Actions for the warm-up episodes, before there is a model to plan with."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from common.demonstrations import Demonstrations
from common.messages import WARMUP_MODES, Episode, Mode, Warmup

WarmupKind = Literal["uniform", "mix"]

# Chance that a joint gets a new target in a step, one drawn per episode: from a new posture at each step to
# postures that are held for 20 steps, so that the data also shows the hand at rest.
_REDRAW_CHANCES = (1.0, 0.3, 0.1, 0.05)


class WarmupActions(Iterator[NDArray[np.float32]]):
    """Endless actions (A,) in [-1, 1], the same for the same (kind, seed, episode) on every machine.

    `uniform` draws every joint anew at each step, the paper's warm-up (Sec. IV-A). `mix` keeps each joint's
    target until it is redrawn.
    # Paper: `mix` is not in it; at the same 5000 steps its model predicts 2 to 3 times better near rest.
    """

    def __init__(self, kind: WarmupKind, action_dim: int, seed: int, episode: int = 0) -> None:
        if kind not in get_args(WarmupKind):
            raise ValueError(f"no warm-up {kind!r}; choose one of {', '.join(get_args(WarmupKind))}")
        self._rng = np.random.default_rng((seed, episode))
        self._redraw_chance = 1.0 if kind == "uniform" else float(self._rng.choice(_REDRAW_CHANCES))
        self._action = self._draw(action_dim)

    def __next__(self) -> NDArray[np.float32]:
        """The next action (A,)."""
        action = self._action
        redraw = self._rng.uniform(size=action.shape) < self._redraw_chance
        self._action = np.where(redraw, self._draw(action.size), action)
        return action

    def _draw(self, action_dim: int) -> NDArray[np.float32]:
        return self._rng.uniform(-1.0, 1.0, action_dim).astype(np.float32)


def warmup_script(
    episode: Episode, action_dim: int, demonstrations: Demonstrations | None
) -> Iterator[NDArray[np.float32]]:
    """Actions (A,) of a warm-up episode: random, or the demonstration of its number; of others, none.

    Raises ValueError for a `glove` episode without demonstrations.
    """
    if episode.mode not in WARMUP_MODES:
        return iter(())
    if episode.mode is Mode.RANDOM:
        kind = "mix" if episode.warmup is Warmup.MIX else "uniform"
        return WarmupActions(kind, action_dim, episode.seed, episode.episode)
    if demonstrations is None:
        raise ValueError("a glove episode wants demonstrations")
    return iter(demonstrations.episode(episode.episode, episode.steps))

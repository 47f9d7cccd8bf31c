"""Somebody who turns the die in the twin's hand, as a person with a glove would show it.

Movements are a few fingers at a time, smooth, around the cupped hand. Of several that come to mind the one is
made that the twin says brings the die nearest to its goal; a take in which the die falls is thrown away.
"""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.angles import to_normalised
from common.dexhand021.tables import HIGH_RAD
from services.sim.dexhand_twin import CUP_RAD, DexHandTwin

Floats = NDArray[np.float64]

MOVE_STEPS = (2, 5)  # control steps of a movement, from and below
TAKES = 20  # attempts at one demonstration
# Motors that people move together: thumb, each finger, two neighbours, all fingers.
SYNERGIES: tuple[tuple[int, ...], ...] = (
    *((0, 1, 2), (2,), (4, 5), (6, 7), (8, 9), (10, 11)),
    *((4, 5, 6, 7), (6, 7, 8, 9), (8, 9, 10, 11), (0, 1, 2, 4, 5), (4, 5, 6, 7, 8, 9, 10, 11), (3,)),
)
RELAX = 0.15  # share of the way back to the cup that resting fingers go in a movement


@dataclass(frozen=True, eq=False)
class Demonstration:
    """Postures (N, 12), rad, at the control rate; `takes` includes those thrown away."""

    postures_rad: Floats
    turned_rad: float  # how much nearer the die came to the goal's rotation
    takes: int


class Demonstrator:
    """Shows one demonstration per call, on a twin of its own; the same seed shows the same."""

    def __init__(self, candidates: int = 16, rate_hz: float = 3.0) -> None:
        """`candidates` are the movements that come to mind at a time. Raises ValueError for none."""
        if candidates < 1:
            raise ValueError(f"candidates must be at least 1, got {candidates}")
        self._candidates = candidates
        self._twin = DexHandTwin(rate_hz=rate_hz)

    def demonstrate(self, seed: int, steps: int) -> Demonstration:
        """Postures (steps, 12). Raises RuntimeError if the die falls in every take."""
        rng = np.random.default_rng((seed, steps))
        for take in range(TAKES):
            self._twin.reset(seed + take)
            begin_rad = self._off()
            postures = self._take(rng, steps)
            if postures is not None:
                return Demonstration(postures, begin_rad - self._off(), take + 1)
        raise RuntimeError(f"demonstration {seed}: the die fell in each of {TAKES} takes")

    def _take(self, rng: np.random.Generator, steps: int) -> Floats | None:
        path = np.asarray(CUP_RAD, np.float64)[None]
        while len(path) < steps:
            move = self._best_move(rng, path[-1])
            if move is None:
                return None
            self._make(move)
            path = np.concatenate([path, move])
        return path[:steps]

    def _best_move(self, rng: np.random.Generator, posture: Floats) -> Floats | None:
        """The movement (n, 12) that leaves the die nearest to the goal; None if it falls in all."""
        before = self._twin.save()
        best, best_score = None, -np.inf
        for _ in range(self._candidates):
            move = self._idea(rng, posture)
            self._make(move)
            score = -self._off() / len(move) ** 0.5 if self._twin.holding else -np.inf
            self._twin.restore(before)
            if score > best_score:
                best, best_score = move, score
        return best

    def _idea(self, rng: np.random.Generator, posture: Floats) -> Floats:
        """One or two synergies to somewhere in their range, the others a little back to the cup."""
        end = posture + RELAX * (CUP_RAD - posture)
        for _ in range(int(rng.integers(1, 3))):
            motors = list(SYNERGIES[int(rng.integers(len(SYNERGIES)))])
            end[motors] = rng.uniform(0.0, HIGH_RAD[motors])
        count = int(rng.integers(*MOVE_STEPS))
        tau = (np.arange(1, count + 1) / count)[:, None]
        share = tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)  # least jerk
        return np.clip(posture + share * (end - posture), 0.0, HIGH_RAD)

    def _make(self, move: Floats) -> None:
        for posture in move:
            self._twin.step(to_normalised(posture))

    def _off(self) -> float:
        """Angle, rad, between the die's rotation and the goal's."""
        errors: dict[str, Any] = self._twin.task.errors(self._twin.state, self._twin.goal)
        return float(errors["rotation_rad"])

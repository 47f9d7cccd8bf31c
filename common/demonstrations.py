"""Recorded actions for the warm-up: cut into episodes, each used once before any is used again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float32 = NDArray[np.float32]


class Demonstrations:
    """Recordings (T, A) of normalised actions at the control rate; T may differ between them."""

    def __init__(self, recordings: Sequence[ArrayLike]) -> None:
        """Values beyond [-1, 1] are cut. Raises ValueError for none, an empty or a non-finite recording."""
        arrays = [np.asarray(recording, np.float32) for recording in recordings]
        if not arrays or any(array.ndim != 2 or not len(array) for array in arrays):
            raise ValueError("demonstrations: at least one recording (T, A) with T >= 1 is wanted")
        if len({array.shape[1] for array in arrays}) > 1 or not all(np.isfinite(a).all() for a in arrays):
            raise ValueError("demonstrations: all recordings must have the same A and finite actions")
        self._recordings = [np.clip(array, -1.0, 1.0) for array in arrays]

    @property
    def samples(self) -> int:
        """Number of actions in all recordings."""
        return sum(map(len, self._recordings))

    def episodes(self, steps: int) -> int:
        """How many episodes of `steps` it takes to show every action once."""
        return len(self._begins(steps))

    def episode(self, number: int, steps: int) -> Float32:
        """Actions (steps, A) of the episode with this number, the same on every machine.

        Numbers beyond `episodes` begin anew. The last episode of a recording ends with it, so that it may
        repeat some of the one before; a recording shorter than an episode is held at its end.
        """
        begins = self._begins(steps)
        index, begin = begins[number % len(begins)]
        actions = self._recordings[index][begin : begin + steps]
        held = np.repeat(actions[-1:], steps - len(actions), axis=0)
        return np.concatenate([actions, held])

    def _begins(self, steps: int) -> list[tuple[int, int]]:
        """Recording and first action of each episode."""
        return [
            (index, max(0, min(begin, len(recording) - steps)))
            for index, recording in enumerate(self._recordings)
            for begin in range(0, len(recording), steps)
        ]

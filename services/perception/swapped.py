"""Does a camera send BGR where RGB is wanted? A coloured die tells; for a grey one it does not matter."""

# pyright: strict

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.die import Die

_STRIDE = 4
_NEAR = 0.12  # of chromaticities, that sum to 1: light and exposure change them by less
_COLOURED = 0.15  # between red and blue; a less coloured die cannot tell
_MIN_SHARE = 0.002  # of the picture: a die of 60 mm at 0.6 m is ten times as large
_TIMES = 5.0  # as much of the swapped colour as of the right one
_MIN_LEVEL = 60  # sum of the three: darker pixels have no colour


def red_and_blue_swapped(colour: NDArray[np.uint8], die: Die) -> bool:
    """Whether a picture (H, W, 3) shows the colour of the die's body with red and blue exchanged instead."""
    body = np.array(die.body_rgb, np.float64) / sum(die.body_rgb)
    if abs(body[0] - body[2]) < _COLOURED:
        return False
    levels = colour[::_STRIDE, ::_STRIDE].astype(np.float64)
    total: NDArray[np.float64] = levels.sum(axis=-1)
    shares: NDArray[np.float64] = levels / np.maximum(total, 1.0)[..., None]
    bright = total >= _MIN_LEVEL

    def share_of(chromaticity: NDArray[np.float64]) -> float:
        near: NDArray[np.bool_] = np.all(np.abs(shares - chromaticity) < _NEAR, axis=-1)
        return float(np.mean(near & bright))

    swapped = share_of(body[::-1])
    return swapped >= _MIN_SHARE and swapped > _TIMES * share_of(body)

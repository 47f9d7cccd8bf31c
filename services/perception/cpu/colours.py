"""How much more likely a colour is on the die than beside it: log-odds by RGB in 16x16x16 bins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.die import FACES, PIPS, Die

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Colours = NDArray[np.uint8]

BINS = 16
_SHADES = np.linspace(0.15, 1.15, 80)  # of the light on a face
_SPREAD = 10.0  # levels by which a channel differs beside shading: white balance, wear, noise
_FLOOR = 0.02  # share of pixels whose colour says nothing
_PRIOR_PIXELS = 300.0  # what the model's own colours are worth against pixels that were seen
_FORGET = 0.9


@dataclass(frozen=True)
class ColourModel:
    """Colours of the die and of what is around it, as counts (4096,) by bin; `odds` (16, 16, 16) follows.

    `paint` are the shares that the die's own paint would take under any light.
    """

    paint: Float64
    on_die: Float64
    elsewhere: Float64
    odds: Float32

    def learned(self, on_die: Colours, elsewhere: Colours) -> ColourModel:
        """With pixels (N, 3) known to show the die, and pixels known not to; older ones count less."""
        return _model(
            self.paint,
            _FORGET * self.on_die + _histogram(on_die),
            _FORGET * self.elsewhere + _histogram(elsewhere),
        )


def colours_of(die: Die) -> ColourModel:
    """What the die's paint alone says; everything else may have any colour."""
    return _model(_paint_histogram(die), np.zeros(BINS**3), np.zeros(BINS**3))


def _model(paint: Float64, on_die: Float64, elsewhere: Float64) -> ColourModel:
    die, others = _mixed(paint, on_die), _mixed(np.full(BINS**3, 1.0 / BINS**3), elsewhere)
    odds = np.log(die / others).astype(np.float32).reshape(BINS, BINS, BINS)
    return ColourModel(paint, on_die, elsewhere, odds)


def _mixed(prior: Float64, seen: Float64) -> Float64:
    share = (_PRIOR_PIXELS * prior + seen) / (_PRIOR_PIXELS + seen.sum())
    return (1 - _FLOOR) * share + _FLOOR / BINS**3


def bins_of(colour: Colours) -> NDArray[np.int32]:
    """Bin (...) of colours (..., 3)."""
    high = np.right_shift(colour, 4).astype(np.int32)
    return (high[..., 0] << 8) | (high[..., 1] << 4) | high[..., 2]


def _histogram(colour: Colours) -> Float64:
    return np.bincount(bins_of(colour).ravel(), minlength=BINS**3).astype(np.float64)


def _paint_histogram(die: Die) -> Float64:
    """Shares (4096,) of colours that body and pips take under more or less light."""
    ink = sum(map(len, PIPS)) * np.pi * die.pip_radius_m**2 / (FACES * die.size_m**2)
    shares = np.zeros((BINS, BINS, BINS))
    for rgb, weight in ((die.body_rgb, 1 - ink), (die.pip_rgb, ink)):
        for shade in _SHADES:
            channels = [_channel(shade * level) for level in rgb]
            shares += weight * np.einsum("i,j,k->ijk", *channels) / len(_SHADES)
    return shares.ravel() / shares.sum()


def _channel(level: float) -> Float64:
    """Shares (16,) of the bins of one channel about a level that clips at 255."""
    centres = (np.arange(BINS) + 0.5) * 256 / BINS
    spread = np.exp(-0.5 * ((centres - min(level, 255.0)) / _SPREAD) ** 2)
    return spread / spread.sum()

"""The affine fit of one person in one glove, from recordings of a few held postures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.glove import ROTATION, mapped_deg
from common.dexhand021.glove_config import GloveUser
from common.dexhand021.glove_recording import GloveError, Recording
from common.dexhand021.tables import HIGH_RAD, JOINTS, MOTORS

Float64 = NDArray[np.float64]

_FINGERS = ("ff_dip", "ff_mcp", "mf_dip", "mf_mcp", "rf_dip", "rf_mcp", "lf_dip", "lf_mcp")
# What the person does, and as which share of its range each motor that it is about is then meant.
POSTURES: Mapping[str, Mapping[str, float]] = {
    "flat": {joint.name: 0.0 for joint in JOINTS},  # all straight, fingers closed, thumb out to the side
    "spread": {"ff_spr": 1.0},  # fingers straight and as far apart as they go
    "fist": dict.fromkeys(_FINGERS, 1.0),
    "thumb_bent": {"th_dip": 1.0, "th_mcp": 1.0},
    "thumb_forward": {"th_rot": 0.5},  # straight out of the palm
    "thumb_across": {"th_rot": 0.9},  # over the palm to the little finger's base
}
LEAST_DEG = 5.0  # a smaller movement between postures is a sensor's noise


@dataclass(frozen=True, eq=False)
class Fit:
    """The fit, and by how much it misses each posture's angles at most: (12,) degrees."""

    user: GloveUser
    miss_deg: Float64


def fit(recordings: Mapping[str, Recording]) -> Fit:
    """Least squares over POSTURES. Raises GloveError for a missing posture or a motor that shows in none."""
    missing = [name for name in POSTURES if name not in recordings]
    if missing:
        raise GloveError(
            f"there is no recording of the posture {missing[0]}; there must be {', '.join(POSTURES)}"
        )
    seen = {name: _held(recordings[name]) for name in POSTURES}
    gain, offset, miss = np.ones(MOTORS), np.zeros(MOTORS), np.zeros(MOTORS)
    thumb_spread_gain = 0.0
    for motor, joint in enumerate(JOINTS):
        postures = [name for name, targets in POSTURES.items() if joint.name in targets]
        high_deg = float(np.degrees(HIGH_RAD[motor]))
        wanted = np.array([POSTURES[name][joint.name] * high_deg for name in postures])
        inputs = np.array([_inputs(seen[name], motor) for name in postures])
        gains = _gains(joint.name, postures, inputs, wanted)
        gain[motor], offset[motor] = gains[0], wanted.mean() - gains @ inputs.mean(axis=0)
        miss[motor] = np.abs(inputs @ gains + offset[motor] - wanted).max()
        if motor == ROTATION:
            thumb_spread_gain = float(gains[1])
    rounded = [tuple(round(float(value), 6) for value in values) for values in (gain, offset)]
    user = GloveUser(gain=rounded[0], offset_deg=rounded[1], thumb_spread_gain=round(thumb_spread_gain, 6))
    return Fit(user, miss)


def _held(recording: Recording) -> tuple[Float64, float]:
    """What each motor follows (12,), and the thumb's spread, while the posture was held: the medians."""
    followed, thumb_spread = mapped_deg(recording.angles_deg)
    return np.median(followed, axis=0), float(np.median(thumb_spread))


def _inputs(held: tuple[Float64, float], motor: int) -> list[float]:
    followed, thumb_spread = held
    own = float(followed[motor])
    return [own, thumb_spread] if motor == ROTATION else [own]


def _gains(name: str, postures: list[str], inputs: Float64, wanted: Float64) -> Float64:
    """Gain per input, shortest where the thumb's two always go together and so cannot be told apart."""
    centred = inputs - inputs.mean(axis=0)
    moved = float(np.linalg.norm(centred, 2))
    if moved < LEAST_DEG:
        raise GloveError(
            f"{name}: the glove shows the same in {' and '.join(postures)} (within {moved:.1f} deg): "
            "hold the postures apart, or see to the sensor"
        )
    inverse = np.asarray(np.linalg.pinv(centred, rcond=LEAST_DEG / moved), np.float64)  # pyright: ignore[reportUnknownArgumentType]
    return inverse @ (wanted - wanted.mean())

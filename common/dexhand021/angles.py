"""Angles of the twelve motors: normalised to [-1, 1], in radians, in hundredths of a degree, in Hall counts.

Arrays are (..., 12) in the order of JOINTS. Radians are the planner's and the model's side: positive is
flexion, opposition or spreading; `sign` (12,) of ±1 is what the hand on the wire calls positive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.dexhand021.tables import HALL_COUNTS_PER_DEG, HIGH_RAD, JOINTS, LOW_RAD

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]

_HALL_COUNTS_PER_RAD = np.array([HALL_COUNTS_PER_DEG * np.degrees(joint.hall_scale) for joint in JOINTS])


def to_radians(action: ArrayLike) -> Float64:
    """Map [-1, 1] to each motor's range; values beyond, and NaN, pass through for the limits to judge."""
    return LOW_RAD + (np.asarray(action, np.float64) + 1.0) * 0.5 * (HIGH_RAD - LOW_RAD)


def to_normalised(position_rad: ArrayLike) -> Float32:
    """The inverse of `to_radians`; what lies outside the range, as a pushed joint may, leaves [-1, 1]."""
    position = np.asarray(position_rad, np.float64)
    return (2.0 * (position - LOW_RAD) / (HIGH_RAD - LOW_RAD) - 1.0).astype(np.float32)


def to_wire_cdeg(position_rad: ArrayLike, sign: ArrayLike = 1) -> NDArray[np.int64]:
    """Radians to hundredths of a degree, the unit of the angle modes. Raises ValueError for non-finite."""
    position = np.asarray(position_rad, np.float64)
    if not np.all(np.isfinite(position)):
        raise ValueError("a position is not finite")
    return np.rint(100.0 * np.degrees(position) * np.asarray(sign)).astype(np.int64)


def from_wire_cdeg(angle_cdeg: ArrayLike, sign: ArrayLike = 1) -> Float64:
    """Hundredths of a degree, as the joint sensors report them, to radians."""
    return np.radians(np.asarray(angle_cdeg, np.float64) * np.asarray(sign) / 100.0)


def to_hall_counts(position_rad: ArrayLike) -> NDArray[np.int64]:
    """Radians to the counts of the motors' Hall sensors, from the position at power-on."""
    return np.rint(np.asarray(position_rad, np.float64) * _HALL_COUNTS_PER_RAD).astype(np.int64)

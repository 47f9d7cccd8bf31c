"""From a person's hand to the DexHand 021: the map of twenty glove angles to twelve motors, and their fit.

Own proposal, in the absence of a published one (docs/guides/glove.md): a finger's `mcp` follows the MCP's
flexion, its `dip` the mean of PIP and DIP, which one motor bends; the spread motor the mean spread of index,
ring and little finger, whichever way they lean; `th_rot` the thumb's CMC joint, flexion and spread.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.dexhand021.angles import to_normalised
from common.dexhand021.glove_config import GloveUser
from common.dexhand021.glove_recording import COLUMNS, Recording
from common.dexhand021.tables import HIGH_RAD, JOINTS, LOW_RAD

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

# The glove's columns whose mean a motor follows. Thumb: Manus calls MCP and IP joint PIP and DIP.
MAP: dict[str, tuple[str, ...]] = {
    "th_dip": ("Thumb_DIP_Flex",),
    "th_mcp": ("Thumb_PIP_Flex",),
    "th_rot": ("Thumb_CMC_Flex",),
    "ff_spr": ("Index_MCP_Spread", "Ring_MCP_Spread", "Pinky_MCP_Spread"),
    "ff_dip": ("Index_PIP_Flex", "Index_DIP_Flex"),
    "ff_mcp": ("Index_MCP_Flex",),
    "mf_dip": ("Middle_PIP_Flex", "Middle_DIP_Flex"),
    "mf_mcp": ("Middle_MCP_Flex",),
    "rf_dip": ("Ring_PIP_Flex", "Ring_DIP_Flex"),
    "rf_mcp": ("Ring_MCP_Flex",),
    "lf_dip": ("Pinky_PIP_Flex", "Pinky_DIP_Flex"),
    "lf_mcp": ("Pinky_MCP_Flex",),
}
ROTATION = [joint.name for joint in JOINTS].index("th_rot")
_SPREAD = [joint.name for joint in JOINTS].index("ff_spr")
_THUMB_SPREAD = COLUMNS.index("Thumb_CMC_Spread")


@dataclass(frozen=True, eq=False)
class GloveActions:
    """Actions (N, 12) at the control rate, and the share (12,) of them that lay outside a motor's range."""

    source: str
    actions: Float32
    cut: Float64


def mapped_deg(angles_deg: ArrayLike) -> tuple[Float64, Float64]:
    """Glove angles (T, 20) to what each motor follows (T, 12), and the thumb's spread (T,), in degrees."""
    angles = np.asarray(angles_deg, np.float64)
    columns = [[COLUMNS.index(name) for name in MAP[joint.name]] for joint in JOINTS]
    followed: list[Float64] = [angles[:, each].mean(axis=1) for each in columns]
    followed[_SPREAD] = np.abs(angles[:, columns[_SPREAD]]).mean(axis=1)
    return np.stack(followed, axis=1), angles[:, _THUMB_SPREAD]


def motor_angles(angles_deg: ArrayLike, user: GloveUser) -> Float64:
    """Glove angles (T, 20), degrees, to motor angles (T, 12), rad, within reach or not."""
    followed, thumb_spread = mapped_deg(angles_deg)
    degrees = np.array(user.gain) * followed + np.array(user.offset_deg)
    degrees[:, ROTATION] += user.thumb_spread_gain * thumb_spread
    return np.radians(degrees)


def to_actions(recording: Recording, user: GloveUser, rate_hz: float) -> GloveActions:
    """Where the person's hand was at each control step, normalised and cut to [-1, 1]."""
    motors = motor_angles(_resampled(recording, rate_hz), user)
    outside = (motors < LOW_RAD - 1e-6) | (motors > HIGH_RAD + 1e-6)
    actions = to_normalised(np.clip(motors, LOW_RAD, HIGH_RAD))
    return GloveActions(recording.source, np.clip(actions, -1.0, 1.0), outside.mean(axis=0))


def _resampled(recording: Recording, rate_hz: float) -> Float64:
    """Angles (N, 20) at 0, 1/rate, 2/rate, ..., on straight lines between the samples."""
    steps = int(recording.t_ns[-1] * rate_hz / 1e9 + 1e-6)
    times = np.rint(np.arange(steps + 1) * 1e9 / rate_hz)
    angles = recording.angles_deg
    return np.stack([np.interp(times, recording.t_ns, angles[:, i]) for i in range(len(COLUMNS))], axis=1)

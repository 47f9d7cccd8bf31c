"""A person in a data glove, as far as demonstrations need one: how a hand's posture shows in the glove.

The opposite way of common.dexhand021.glove, written apart from it.
"""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.dexhand021.glove_config import GloveUser
from common.dexhand021.glove_recording import COLUMNS, Recording
from common.dexhand021.tables import HIGH_RAD

Floats = NDArray[np.float64]

GLOVE_HZ = 60.0  # as Manus exports
DIP_PER_PIP = 0.7  # of a relaxed human finger
TH_DIP, TH_MCP, TH_ROT, SPREAD = range(4)  # motors; the fingers' follow in pairs, dip and mcp
_COLUMN = {name: index for index, name in enumerate(COLUMNS)}
_FINGERS = ("Index", "Middle", "Ring", "Pinky")
_LEAN = {"Index": 1.0, "Middle": 0.0, "Ring": -1.0, "Pinky": -1.0}


@dataclass(frozen=True)
class Person:
    """Somebody whose `fit` would make the glove exact; `noise_deg` is the sensors' standard deviation."""

    fit: GloveUser = field(default_factory=GloveUser)
    noise_deg: float = 0.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, noise_deg: float = 0.3) -> Person:
        """Another person: gains within 15 %, offsets within 6 degrees."""
        gain, offset = rng.uniform(0.87, 1.15, 12), rng.uniform(-6.0, 6.0, 12)
        offset[SPREAD] = rng.uniform(-3.0, 0.0)  # fingers never lean to the other side than this map's
        fit = GloveUser(
            gain=tuple(map(float, gain)),
            offset_deg=tuple(map(float, offset)),
            thumb_spread_gain=float(rng.uniform(0.8, 1.3)),
        )
        return cls(fit, noise_deg)

    def glove_angles(self, motors_rad: ArrayLike) -> Floats:
        """What the glove shows (T, 20), degrees, when the hand means motor angles (T, 12)."""
        motors = np.degrees(np.asarray(motors_rad, np.float64)) - np.array(self.fit.offset_deg)
        gain = np.array(self.fit.gain)
        angles = np.zeros((len(motors), len(COLUMNS)))
        angles[:, _COLUMN["Thumb_DIP_Flex"]] = motors[:, TH_DIP] / gain[TH_DIP]
        angles[:, _COLUMN["Thumb_PIP_Flex"]] = motors[:, TH_MCP] / gain[TH_MCP]
        # A thumb spreads first, and then flexes over the palm.
        share = 0.25 + 0.4 * motors[:, TH_ROT] / np.degrees(HIGH_RAD[TH_ROT])
        angles[:, _COLUMN["Thumb_CMC_Flex"]] = share * motors[:, TH_ROT] / gain[TH_ROT]
        by_spread = (1.0 - share) * motors[:, TH_ROT] / self.fit.thumb_spread_gain
        angles[:, _COLUMN["Thumb_CMC_Spread"]] = by_spread
        for finger, name in enumerate(_FINGERS):
            dip, mcp = 4 + 2 * finger, 5 + 2 * finger
            pip = 2.0 * motors[:, dip] / gain[dip] / (1.0 + DIP_PER_PIP)
            angles[:, _COLUMN[f"{name}_PIP_Flex"]] = pip
            angles[:, _COLUMN[f"{name}_DIP_Flex"]] = DIP_PER_PIP * pip
            angles[:, _COLUMN[f"{name}_MCP_Flex"]] = motors[:, mcp] / gain[mcp]
            angles[:, _COLUMN[f"{name}_MCP_Spread"]] = _LEAN[name] * motors[:, SPREAD] / gain[SPREAD]
        return angles

    def record(
        self, waypoints_rad: ArrayLike, rate_hz: float, rng: np.random.Generator, source: str
    ) -> Recording:
        """A recording at GLOVE_HZ of a smooth movement through postures (N, 12) at `rate_hz`."""
        waypoints = np.asarray(waypoints_rad, np.float64)
        per_point = round(GLOVE_HZ / rate_hz)
        times = np.arange((len(waypoints) - 1) * per_point + 1)
        angles = self.glove_angles(_through(waypoints, times / per_point))
        angles = angles + rng.normal(0.0, self.noise_deg, angles.shape)
        t_ns = np.rint(times * 1e9 / GLOVE_HZ).astype(np.int64)
        return Recording(source, t_ns, angles.astype(np.float32))


def _through(points: Floats, at: Floats) -> Floats:
    """A Catmull-Rom spline through `points` (N, A), one a unit of time, at times (T,); within the range."""
    slopes = np.gradient(points, axis=0) if len(points) > 1 else np.zeros_like(points)
    index = np.minimum(at.astype(np.int64), max(len(points) - 2, 0))
    following = np.minimum(index + 1, len(points) - 1)
    u = (at - index)[:, None]
    blend = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2, u**2 * (3 - 2 * u), u**2 * (u - 1)
    path = (
        blend[0] * points[index]
        + blend[1] * slopes[index]
        + blend[2] * points[following]
        + blend[3] * slopes[following]
    )
    return np.clip(path, 0.0, HIGH_RAD)

"""How the die and the fingers move: kinematic, so that speed and occlusion are what a sequence asks for.

World: metres, z up, the hand's middle near the origin. Letters: N instants, J 4 joints of a finger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common import geometry
from common.die import Die

Float64 = NDArray[np.float64]

_STEP_S = 0.002
# Of a finger's four joints from the tip: how much further round the die each is, at most, and how far out.
_BEND_RAD = np.array([0.0, 0.45, 0.95, 1.45])
_FARTHEST_RAD = np.array([2.2, 2.3, 2.4, 2.5])
_ARCHED = np.array([0.0, 1.0, 1.0, 1.0])
_LIFT_M = np.array([0.0, 0.0, 0.008, 0.02])
_GAP_M = 0.0003


class Wave:
    """Smooth random functions of time: three sines each, scaled to [-1, 1]."""

    def __init__(self, rng: np.random.Generator, count: int, hz: float) -> None:
        self._rate = 2 * math.pi * hz * rng.uniform(0.5, 1.5, (count, 3))
        self._phase = rng.uniform(0, 2 * math.pi, (count, 3))

    def __call__(self, t_s: float) -> Float64:
        """Values (count,) at a time."""
        return np.sin(self._rate * t_s + self._phase).sum(axis=1) / 3


class DieMotion:
    """The die turns at about `speed` about an axis that wanders, and shifts by some millimetres."""

    def __init__(self, rng: np.random.Generator, speed_deg_s: float, seconds: float) -> None:
        """Integrated on a grid from half a second before 0 to half a second after the end."""
        self._begin = -0.5
        axis, pace = Wave(rng, 3, 0.25), Wave(rng, 1, 0.5)
        self._shift = Wave(rng, 3, 0.4)
        start = rng.standard_normal(4)
        rotations = [start / np.linalg.norm(start)]
        heading = rng.standard_normal(3)
        for index in range(math.ceil((seconds + 1.0) / _STEP_S)):
            t_s = self._begin + index * _STEP_S
            about = heading / np.linalg.norm(heading) + 1.5 * axis(t_s)
            speed = math.radians(speed_deg_s) * (1.0 + 0.6 * float(pace(t_s)[0]))
            turn = geometry.from_axis_angle(about, np.array(speed * _STEP_S))
            rotations.append(geometry.normalise(geometry.multiply(turn, rotations[-1])))
        self._rotations = np.array(rotations)

    def pose(self, t_s: float) -> tuple[Float64, Float64]:
        """Position (3,) m and rotation (4,) wxyz in the world."""
        at = (t_s - self._begin) / _STEP_S
        first = int(at)
        mixed = self._rotations[first] + (at - first) * (self._rotations[first + 1] - self._rotations[first])
        return 0.008 * self._shift(t_s), geometry.normalise(mixed)


@dataclass(frozen=True)
class Grip:
    """How far fingertips reach over the die: angles (rad) from the line to the camera, least and most."""

    nearest_rad: float
    farthest_rad: float
    hz: float = 0.35


GRIPS: dict[str, Grip] = {
    "open": Grip(1.35, 2.0),
    "held": Grip(0.30, 1.10),
    "covered": Grip(0.10, 0.75),
}


class Capsule(NamedTuple):
    """A rod with round ends in the world, metres."""

    start: Float64
    end: Float64
    radius: float


class Fingers:
    """Five bent fingers about the die, tips sliding on its surface; `towards` (3,) points to the camera."""

    def __init__(self, rng: np.random.Generator, die: Die, grip: Grip, towards: Float64) -> None:
        self._die, self._grip = die, grip
        self._frame = _frame_about(towards)
        spread = np.array([0.0, 1.7, 2.3, 2.9, 3.5]) + rng.normal(0.0, 0.15, 5)  # a thumb and four beside it
        self._azimuth = spread + rng.uniform(0, 2 * math.pi)
        self._radius = rng.uniform(0.0080, 0.0105, 5)
        self._arch = rng.uniform(0.050, 0.060, 5)
        self._reach, self._wander = Wave(rng, 5, grip.hz), Wave(rng, 5, grip.hz)

    def capsules(self, t_s: float, position: Float64, rotation: Float64) -> list[Capsule]:
        """Three rods for each finger (15) about a die at (3,), (4,)."""
        middle = (self._grip.nearest_rad + self._grip.farthest_rad) / 2
        swing = (self._grip.farthest_rad - self._grip.nearest_rad) / 2
        polar = middle + swing * np.clip(1.6 * self._reach(t_s), -1, 1)
        azimuth = self._azimuth + 0.15 * self._wander(t_s)
        joints = self._joints(polar, azimuth, rotation) + position
        return [
            Capsule(chain[rod], chain[rod + 1], float(radius))
            for chain, radius in zip(joints, self._radius, strict=True)
            for rod in range(3)
        ]

    def _joints(self, polar: Float64, azimuth: Float64, rotation: Float64) -> Float64:
        """Points (5, J, 3) from tip to knuckle about the die, moved outwards until no rod cuts into it."""
        angles = np.minimum(polar[:, None] + _BEND_RAD, _FARTHEST_RAD)
        across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)[:, None]
        ways = np.concatenate([np.sin(angles)[..., None] * across, np.cos(angles)[..., None]], axis=-1)
        ways = ways @ self._frame
        seen = geometry.rotate(geometry.conjugate(rotation), ways)
        clear = self._radius + _GAP_M
        far = np.maximum(self._arch[:, None] * _ARCHED + _LIFT_M, self._touching(seen, clear))
        for _ in range(6):
            short = self._shortfall(seen * far[..., None], clear)
            far[:, :-1] += short
            far[:, 1:] += short
        return ways * far[..., None]

    def _touching(self, seen: Float64, clear: Float64) -> Float64:
        """How far out (5, J) along directions (5, J, 3) in the die's frame a ball just touches it."""
        low, high = np.zeros(seen.shape[:2]), np.full(seen.shape[:2], 0.12)
        for _ in range(14):
            middle = (low + high) / 2
            inside = _distance(middle[..., None] * seen, self._die) < clear[:, None]
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return high

    def _shortfall(self, joints: Float64, clear: Float64) -> Float64:
        """How much (5, J - 1) the rods between joints (5, J, 3) are too near."""
        share = np.linspace(0.0, 1.0, 7)[:, None]
        between = joints[:, :-1, None] * (1 - share) + joints[:, 1:, None] * share
        return np.maximum(clear[:, None] - _distance(between, self._die).min(axis=-1), 0.0)


def _distance(points: Float64, die: Die) -> Float64:
    """Signed distance (...) of points (..., 3) in the die's frame from its rounded surface."""
    beyond = np.abs(points) - (die.half_m - die.corner_radius_m)
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return outside + np.minimum(beyond.max(axis=-1), 0.0) - die.corner_radius_m


def _frame_about(towards: Float64) -> Float64:
    """Rows: two directions across and `towards` itself (3, 3)."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, (0.0, 0.0, 1.0) if abs(z[2]) < 0.9 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])

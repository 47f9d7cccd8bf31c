"""Where the die should be by now: constant velocity, believed for as long as a hand keeps to it."""

from __future__ import annotations

import numpy as np

from services.perception.cpu.pose import Float64, Pose, motion, moved

_NS = 1e9
_SHORTEST_S = 0.002  # below it a velocity is noise
_LONGEST_S = 0.1  # beyond it a velocity says nothing
_SMOOTHING = 0.5
_COASTING = 0.7


class Motion:
    """The last pose and its velocity (6,), m/s and rad/s."""

    def __init__(self, pose: Pose, t_ns: int) -> None:
        self.pose, self.t_ns = pose, t_ns
        self.velocity = np.zeros(6)

    def at(self, t_ns: int) -> Pose:
        """The pose expected at a time."""
        elapsed = min(max((t_ns - self.t_ns) / _NS, 0.0), _LONGEST_S)
        return moved(self.pose, elapsed * self.velocity)

    def follow(self, pose: Pose, t_ns: int, trust: float) -> None:
        """Take a pose measured at a later time, into the velocity only as far as it is trusted, 0 to 1."""
        elapsed = (t_ns - self.t_ns) / _NS
        if _SHORTEST_S < elapsed <= _LONGEST_S:
            share = _SMOOTHING * trust
            self.velocity = (1 - share) * self.velocity + share * motion(self.pose, pose) / elapsed
        elif elapsed > _LONGEST_S:
            self.velocity = np.zeros(6)
        self.pose, self.t_ns = pose, t_ns

    def coast(self, t_ns: int) -> None:
        """Go on without a measurement, ever slower: a hidden die does not get far."""
        self.pose, self.t_ns = self.at(t_ns), t_ns
        self.velocity = _COASTING * self.velocity


def expected_within(elapsed_s: float, per_s2: float, least: float) -> float:
    """Deviation of a prediction over a time with accelerations of `per_s2`, at least `least`."""
    return least + 0.5 * per_s2 * elapsed_s**2


def information(translation_m: float, rotation_rad: float) -> Float64:
    """Information (6, 6) of independent deviations."""
    return np.diag([translation_m**-2.0] * 3 + [rotation_rad**-2.0] * 3)

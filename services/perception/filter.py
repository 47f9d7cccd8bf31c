"""Pose filter: constant velocity, outliers, age; quaternions that never jump to the other sign.

A Kalman filter on the error state (dp, dw, dv, dω), 12 numbers in the frame of its measurements: positions in
m, rotations as small turns from the left, exp(dw)·q. The die moves at constant velocity but for white
accelerations. Method: Markley, "Attitude Error Representations for Kalman Filtering" (2003).
"""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from common import geometry
from common.config import Frozen

Float64 = NDArray[np.float64]

NS_PER_S = 1e9
_TINY_RAD = 1e-12
_PUSH_S = 1 / 30  # how long an acceleration lasts before it is another one


class FilterConfig(Frozen):
    """How the die may move, and what is not believed."""

    acceleration_m_s2: float = Field(default=4.0, gt=0.0, description="of the die, one standard deviation")
    acceleration_rad_s2: float = Field(default=40.0, gt=0.0, description="of its turning")
    speed_m_s: float = Field(default=0.5, gt=0.0, description="when it is first seen, likewise")
    speed_rad_s: float = Field(default=5.0, gt=0.0, description="of its turning then")
    noise_m: float = Field(default=0.0003, gt=0.0, description="of a pose, on top of what its backend says")
    noise_rad: float = Field(default=0.01, gt=0.0, description="of a rotation, likewise")
    gate: float = Field(
        default=27.9, gt=0.0, description="squared Mahalanobis distance beyond which a pose is an outlier"
    )  # of 6 degrees of freedom: exceeded by one in 10 000
    confirm: int = Field(
        default=4, ge=2, description="outliers in a row that agree with each other are the new truth"
    )
    max_gap_s: float = Field(default=0.3, gt=0.0, description="after a longer one it starts anew")


class Verdict(StrEnum):
    """What became of a pose."""

    STARTED = "started"  # the first, or the first after a gap or after confirmed outliers
    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    BACKWARDS = "backwards"  # not later than the one before


@dataclass(frozen=True)
class Measured:
    """A pose and its covariance (6, 6) of (dp, dw), in one frame throughout; `t_ns`: when it was seen."""

    t_ns: int
    position: Float64  # (3,) m
    rotation: Float64  # (4,) unit quaternion wxyz
    covariance: Float64


class PoseFilter:
    """Follows one body; what it refuses changes nothing but the count towards `confirm`."""

    def __init__(self, config: FilterConfig) -> None:
        self._config = config
        self._noise = np.diag(_six(config.noise_m, config.noise_rad) ** 2)
        self._accelerations = _six(config.acceleration_m_s2, config.acceleration_rad_s2)
        self._speeds = _six(config.speed_m_s, config.speed_rad_s)
        self._pose: Measured | None = None
        self._velocity: Float64 = np.zeros(6)
        self._covariance: Float64 = np.zeros((12, 12))
        self._rival: PoseFilter | None = None  # follows outliers, in case they are right
        self._rivals = 0  # outliers in a row that agree

    def reset(self) -> None:
        """Forget everything."""
        self._pose, self._rival, self._rivals = None, None, 0

    def update(self, measured: Measured) -> Verdict:
        """Take a pose that was claimed to be good."""
        if self._pose is None:
            return self._start(measured)
        if measured.t_ns <= self._pose.t_ns:
            return Verdict.BACKWARDS
        if measured.t_ns - self._pose.t_ns > self._config.max_gap_s * NS_PER_S:
            return self._start(measured)
        predicted, covariance = self._predicted(self._pose, measured.t_ns)
        residual = _difference(measured, predicted)
        expected = covariance[:6, :6] + measured.covariance + self._noise
        if residual @ np.linalg.solve(expected, residual) > self._config.gate:
            return self._doubt(measured)
        self._rival, self._rivals = None, 0
        self._correct(predicted, covariance, residual, expected)
        return Verdict.ACCEPTED

    def pose(self) -> Measured | None:
        """The pose as of the newest accepted measurement, with that one's time."""
        return self._pose

    def _start(self, measured: Measured) -> Verdict:
        rotation = geometry.normalise(measured.rotation)
        rotation = rotation if self._pose is None else _nearer(rotation, self._pose.rotation)
        covariance = measured.covariance + self._noise
        self._pose = Measured(measured.t_ns, measured.position.copy(), rotation, covariance)
        self._velocity = np.zeros(6)
        self._covariance = np.zeros((12, 12))
        self._covariance[:6, :6] = covariance
        self._covariance[6:, 6:] = np.diag(self._speeds**2)
        self._rival, self._rivals = None, 0
        return Verdict.STARTED

    def _predicted(self, pose: Measured, t_ns: int) -> tuple[Measured, Float64]:
        """Pose at `t_ns` and covariance (12, 12), whatever the number of frames in between."""
        dt = (t_ns - pose.t_ns) / NS_PER_S
        position = pose.position + dt * self._velocity[:3]
        rotation = _turned(pose.rotation, dt * self._velocity[3:])
        transition = np.eye(12)
        transition[:6, 6:] = dt * np.eye(6)
        driven = np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.diag(_PUSH_S * self._accelerations**2))
        covariance = transition @ self._covariance @ transition.T + driven
        return Measured(t_ns, position, rotation, covariance[:6, :6]), covariance

    def _correct(
        self, predicted: Measured, covariance: Float64, residual: Float64, expected: Float64
    ) -> None:
        gain = np.linalg.solve(expected, covariance[:6]).T
        change = gain @ residual
        remaining = np.eye(12)
        remaining[:, :6] -= gain
        noise = expected - covariance[:6, :6]
        # Joseph's form stays positive definite whatever the gain.
        self._covariance = remaining @ covariance @ remaining.T + gain @ noise @ gain.T
        self._velocity = self._velocity + change[6:]
        self._pose = Measured(
            predicted.t_ns,
            predicted.position + change[:3],
            _turned(predicted.rotation, change[3:6]),
            self._covariance[:6, :6],
        )

    def _doubt(self, measured: Measured) -> Verdict:
        """Refuse an outlier, unless enough of them in a row agree: then it was the filter that was wrong."""
        self._rival = self._rival or PoseFilter(self._config)
        if self._rival.update(measured) is Verdict.ACCEPTED:
            self._rivals += 1
        else:
            self._rival._start(measured)
            self._rivals = 1
        if self._rivals < self._config.confirm:
            return Verdict.OUTLIER
        self._take_over(self._rival)
        return Verdict.STARTED

    def _take_over(self, rival: PoseFilter) -> None:
        assert rival._pose is not None and self._pose is not None
        rotation = _nearer(rival._pose.rotation, self._pose.rotation)
        self._pose = replace(rival._pose, rotation=rotation)
        self._velocity, self._covariance = rival._velocity, rival._covariance
        self._rival, self._rivals = None, 0


def _six(linear: float, angular: float) -> Float64:
    return np.array([linear] * 3 + [angular] * 3)


def _nearer(rotation: Float64, reference: Float64) -> Float64:
    """Of the two quaternions of a rotation, the one on the reference's side."""
    return rotation if rotation @ reference >= 0 else -rotation


def _turned(rotation: Float64, vector: Float64) -> Float64:
    """`rotation` (4,) after a turn by the rotation vector (3,); of the two signs, the nearer."""
    angle = float(np.linalg.norm(vector))
    if angle < _TINY_RAD:
        return rotation
    turn = geometry.from_axis_angle(vector, np.asarray(angle))
    return _nearer(geometry.normalise(geometry.multiply(turn, rotation)), rotation)


def _difference(measured: Measured, predicted: Measured) -> Float64:
    """(6,): what would have to be added to the prediction."""
    turn = geometry.multiply(measured.rotation, geometry.conjugate(predicted.rotation))
    return np.concatenate([measured.position - predicted.position, geometry.to_rotation_vector(turn)])

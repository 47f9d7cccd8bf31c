"""Rigid motion of the die before the camera: `T_cam_obj`, OpenCV optical axes (x right, y down, z forward).

A small motion is `xi` (6,), (dp, dw): a shift (3,) m, and a turn (3,) rad about camera axes through the die's
centre. Turning about the centre keeps the two apart: a wrong depth is not a wrong rotation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


class Pose(NamedTuple):
    """Rotation (3, 3) and translation (3,) m: a point x of the die is at `rotation @ x + translation`."""

    rotation: Float64
    translation: Float64


def exponential(turn: Float64) -> Float64:
    """Rotation matrix (3, 3) of a rotation vector (3,) rad. Source: Rodrigues' formula."""
    angle = math.sqrt(float(turn @ turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        return np.eye(3) + cross
    return np.eye(3) + math.sin(angle) / angle * cross + (1 - math.cos(angle)) / angle**2 * cross @ cross


def logarithm(rotation: Float64) -> Float64:
    """Rotation vector (3,) rad, length in [0, π], of a rotation matrix (3, 3)."""
    skew = rotation - rotation.T
    axis = 0.5 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    sine, cosine = math.sqrt(float(axis @ axis)), 0.5 * (float(np.trace(rotation)) - 1)
    if sine > 1e-6:
        return axis * (math.atan2(sine, cosine) / sine)
    if cosine > 0:
        return axis
    # Half a turn: the axis is what the rotation keeps.
    kept = rotation + np.eye(3)
    column = kept[:, np.argmax(np.diag(kept))]
    return math.pi * column / np.linalg.norm(column)


def angle_rad(a: Float64, b: Float64) -> float:
    """Angle, rad in [0, π], between two rotations (3, 3)."""
    return float(np.linalg.norm(logarithm(a @ b.T)))


def moved(pose: Pose, xi: Float64) -> Pose:
    """The pose after a small motion `xi` (6,)."""
    return Pose(exponential(xi[3:]) @ pose.rotation, pose.translation + xi[:3])


def motion(source: Pose, target: Pose) -> Float64:
    """The motion (6,) with which `moved(source, xi)` is `target`."""
    turn = logarithm(target.rotation @ source.rotation.T)
    return np.concatenate([target.translation - source.translation, turn])


def orthonormal(rotation: Float64) -> Float64:
    """The rotations nearest to matrices (..., 3, 3) that rounding has moved off the group."""
    left, _, right = np.linalg.svd(rotation)
    left[..., 2] *= np.linalg.det(left @ right)[..., None]
    return np.asarray(left @ right, np.float64)


def from_matrix(transform: Float64) -> Pose:
    """The pose of a transform (4, 4)."""
    return Pose(transform[:3, :3].copy(), transform[:3, 3].copy())


def to_matrix(pose: Pose) -> Float64:
    """The transform (4, 4) of a pose."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = pose
    return transform

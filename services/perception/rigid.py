"""Rigid transforms (4, 4), metres: apart into position and quaternion, together again, and undone."""

# pyright: strict

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common import geometry

Float64 = NDArray[np.float64]


def join(position: ArrayLike, rotation: ArrayLike) -> Float64:
    """The transform (4, 4) of a position (3,) and a unit quaternion (4,) wxyz."""
    transform = np.eye(4)
    transform[:3, :3] = to_matrix(np.asarray(rotation, np.float64))
    transform[:3, 3] = position
    return transform


def split(transform: Float64) -> tuple[Float64, Float64]:
    """Position (3,) and unit quaternion (4,) wxyz, w >= 0, of a transform (4, 4)."""
    return transform[:3, 3].copy(), from_matrix(transform[:3, :3])


def inverse(transform: Float64) -> Float64:
    """The inverse (4, 4) of a rigid transform."""
    turned = transform[:3, :3].T
    undone = np.eye(4)
    undone[:3, :3] = turned
    undone[:3, 3] = -turned @ transform[:3, 3]
    return undone


def to_matrix(rotation: Float64) -> Float64:
    """Rotation matrix (3, 3) of a unit quaternion (4,)."""
    return geometry.rotate(np.broadcast_to(rotation, (3, 4)), np.eye(3)).T


def from_matrix(matrix: Float64) -> Float64:
    """Unit quaternion (4,), w >= 0, of a rotation matrix (3, 3); of the nearest one if it is not quite one.

    The eigenvector of the largest eigenvalue, which is as good at half turns as anywhere (Bar-Itzhack,
    "New Method for Extracting the Quaternion from a Rotation Matrix", 2000).
    """
    trace, skew = float(np.trace(matrix)), matrix - matrix.T
    form = np.empty((4, 4))
    form[0, 0] = trace
    form[1:, 1:] = matrix + matrix.T - trace * np.eye(3)
    form[0, 1:] = form[1:, 0] = skew[2, 1], skew[0, 2], skew[1, 0]
    vector = np.linalg.eigh(form)[1][:, -1]
    return vector if vector[0] >= 0 else -vector


def turn_covariance(rotation: Float64, covariance: Float64) -> Float64:
    """A covariance (6, 6) of (dp, dw) in another frame; `rotation` (3, 3) maps the first frame to it."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = rotation
    return both @ covariance @ both.T

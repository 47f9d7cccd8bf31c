"""Pose errors as BOP defines them, for an object whose shape is symmetric and whose texture is not.

Definitions from bop_toolkit_lib/pose_error.py (thodan/bop_toolkit, MIT), written anew: it needs numpy 1.
A die slipped by one face has ADD 60 mm, but ADD-S and MSSD of 0. So three numbers belong together: the error
with the true labelling, the error modulo the 24 rotations, and how often the labelling is right.

Letters: V points of the surface; N poses (N, 4, 4), object to camera, metres.
"""

# pyright: strict

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.die import CUBE_ROTATIONS, Die

Float64 = NDArray[np.float64]


def rotation_error_rad(estimated: Float64, true: Float64) -> Float64:
    """Geodesic angle (...), from matrices (..., 3, 3); exact near 0, where arccos of the trace is not."""
    apart = np.linalg.norm(estimated - true, axis=(-2, -1)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.clip(apart, 0.0, 1.0))


def rotation_errors_rad(estimated: Float64, true: Float64) -> Float64:
    """Angle (N, 24) of poses (N, 4, 4) to the truth under each labelling; column 0 is the true one."""
    alike = true[:, None, :3, :3] @ CUBE_ROTATIONS
    return rotation_error_rad(estimated[:, None, :3, :3], alike)


def translation_error_m(estimated: Float64, true: Float64) -> Float64:
    """Distance (N,) of the centres."""
    return np.linalg.norm(estimated[:, :3, 3] - true[:, :3, 3], axis=-1)


def add_m(estimated: Float64, true: Float64, points: Float64) -> Float64:
    """ADD (N,): mean distance of corresponding points (V, 3)."""
    return np.linalg.norm(_moved(estimated, points) - _moved(true, points), axis=-1).mean(axis=-1)


def add_s_m(estimated: Float64, true: Float64, points: Float64) -> Float64:
    """ADD-S (N,), BOP's `adi`: mean distance of each point, truly placed, to the nearest estimated one."""
    return np.array(
        [
            np.linalg.norm(_moved(t, points)[:, None] - _moved(e, points)[None], axis=-1).min(axis=1).mean()
            for e, t in zip(estimated, true, strict=True)
        ]
    )


def mssd_m(estimated: Float64, true: Float64, points: Float64) -> Float64:
    """MSSD (N,): over the cube's rotations, the smallest of the largest distances of points."""
    placed = _moved(estimated, points)
    largest = [
        np.linalg.norm(placed - _moved(true, points @ rotation.T), axis=-1).max(axis=-1)
        for rotation in CUBE_ROTATIONS
    ]
    return np.min(largest, axis=0)


def surface_points(die: Die, side: int = 7) -> Float64:
    """Points (V, 3) for ADD and its kin: a grid on each face, so that a slipped face maps onto itself."""
    at = np.linspace(-1.0, 1.0, side) * (die.half_m - die.corner_radius_m)
    right, up = np.meshgrid(at, at)
    plane = np.stack([right.ravel(), up.ravel(), np.full(right.size, die.half_m)], axis=1)
    return np.concatenate([plane @ frame for frame in die.frames])


def _moved(poses: Float64, points: Float64) -> Float64:
    """Points (..., V, 3) in the camera's frame."""
    return points @ np.swapaxes(poses[..., :3, :3], -1, -2) + poses[..., None, :3, 3]

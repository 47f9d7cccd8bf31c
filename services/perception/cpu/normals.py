"""Surface points and their normals in a crop, and the cube's axes that explain most of the normals."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2 as compiled_cv2
import numpy as np

from services.perception.cpu.pose import Float64, exponential, orthonormal
from services.perception.cpu.terms import tukey
from services.perception.cpu.view import View

cv2: Any = compiled_cv2  # its stubs know neither dtypes nor optional maps

_SMOOTH_PX = 9  # stereo noise is correlated over 5 px
_STEP_PX = 6
_STRIDE = 3
_JUMP_M = 0.02
_CUTOFF_RAD = 0.35


class Oriented(NamedTuple):
    """Surface points (N, 3) m, and unit normals (N, 3) towards the camera."""

    points: Float64
    normals: Float64


def oriented_points(view: View, centre: Float64, radius_m: float) -> Oriented:
    """Points within `radius_m` of `centre` (3,) on a smooth surface of the die's colour."""
    depth = view.depth
    rows, columns = depth.shape
    valid = (depth > 0).astype(np.float32)
    weight = cv2.blur(valid, (_SMOOTH_PX, _SMOOTH_PX))
    smooth = cv2.blur(depth, (_SMOOTH_PX, _SMOOTH_PX)) / np.maximum(weight, 1e-6)
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    camera = view.camera
    points = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    points *= smooth[..., None]
    inner = (slice(_STEP_PX, -_STEP_PX, _STRIDE), slice(_STEP_PX, -_STEP_PX, _STRIDE))
    across = points[_STEP_PX:-_STEP_PX, 2 * _STEP_PX :] - points[_STEP_PX:-_STEP_PX, : -2 * _STEP_PX]
    down = points[2 * _STEP_PX :, _STEP_PX:-_STEP_PX] - points[: -2 * _STEP_PX, _STEP_PX:-_STEP_PX]
    across, down = across[::_STRIDE, ::_STRIDE], down[::_STRIDE, ::_STRIDE]
    normals = np.cross(down, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    middle = points[inner]
    good = (weight[inner] > 0.6) & (view.odds[inner] > 0)
    good &= (np.abs(across[..., 2]) < _JUMP_M) & (np.abs(down[..., 2]) < _JUMP_M)
    good &= np.abs(smooth[inner] - depth[inner]) < 0.004
    good &= np.linalg.norm(middle - centre, axis=-1) < radius_m
    return Oriented(middle[good].astype(np.float64), normals[good].astype(np.float64))


def cube_axes(normals: Float64, starts: Float64, iterations: int = 8) -> tuple[Float64, float]:
    """The rotation (3, 3) whose axes are nearest to most normals (N, 3), and the share of normals explained.

    One of 24 that are alike. Each of the `starts` (S, 3, 3) assigns normals to axes and turns to fit them
    (orthogonal Procrustes), over again.
    """
    best, best_share = np.eye(3), -1.0
    for start in starts:
        rotation, weights = start, np.zeros(len(normals))
        for _ in range(iterations):
            rotation, weights = _turned_to(rotation, normals)
        share = float(weights.mean()) if len(weights) else 0.0
        if share > best_share:
            best, best_share = rotation, share
    return best, best_share


def _turned_to(rotation: Float64, normals: Float64) -> tuple[Float64, Float64]:
    local = normals @ rotation
    axis = np.argmax(np.abs(local), axis=1)
    cosine = np.abs(local[np.arange(len(local)), axis])
    weights = tukey(np.arccos(np.clip(cosine, -1, 1)), _CUTOFF_RAD)
    nearest = np.zeros_like(local)
    nearest[np.arange(len(local)), axis] = np.sign(local[np.arange(len(local)), axis])
    return orthonormal((weights[:, None] * normals).T @ nearest + 1e-9 * rotation), weights


def spread_rotations(count: int, seed: int = 0) -> Float64:
    """Rotations (count, 3, 3) by up to 63 degrees, which is all that a cube's axes can differ by."""
    draw = np.random.default_rng(seed)
    axes = draw.normal(size=(count, 3))
    angles = np.radians(63) * draw.random(count) ** (1 / 3)
    turns = axes / np.linalg.norm(axes, axis=1, keepdims=True) * angles[:, None]
    return np.stack([exponential(turn) for turn in turns])


def planes_along(direction: Float64, cloud: Oriented, least: int) -> list[float]:
    """Offsets n·q, m, of the planes with normal `direction` (3,) that many points lie on, fullest first."""
    aligned = cloud.normals @ direction > np.cos(_CUTOFF_RAD)
    offsets = np.sort(cloud.points[aligned] @ direction)
    found: list[float] = []
    while len(offsets) >= least and len(found) < 2:
        counts = np.searchsorted(offsets, offsets + 0.004) - np.arange(len(offsets))
        first = int(np.argmax(counts))
        if counts[first] < least:
            break
        found.append(float(np.median(offsets[first : first + counts[first]])))
        offsets = offsets[np.abs(offsets - found[-1]) > 0.008]
    return found

"""Surface points and their normals in a crop, and the cube's axes that explain most of the normals."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from services.perception.cpu.pose import Float64, exponential, orthonormal
from services.perception.cpu.terms import cross, dot, tukey
from services.perception.cpu.view import Float32, View

cv2: Any = compiled_cv2  # its stubs know neither dtypes nor optional maps

Int64 = NDArray[np.int64]

_SMOOTH_PX = 9  # stereo noise is correlated over 5 px
_STEP_PX = 6
_STRIDE = 3
_JUMP_M = 0.02
_CUTOFF_RAD = 0.35
_SECOND_FACE = 0.15  # of the normals of the first: fewer are noise


class Oriented(NamedTuple):
    """Surface points (N, 3) m, and unit normals (N, 3) towards the camera."""

    points: Float64
    normals: Float64


def oriented_points(view: View, centre: Float64, radius_m: float) -> Oriented:
    """Points within `radius_m` of `centre` (3,) on a smooth surface of the die's colour."""
    depth = view.depth
    weight = cv2.blur((depth > 0).astype(np.float32), (_SMOOTH_PX, _SMOOTH_PX))
    smooth = cv2.blur(depth, (_SMOOTH_PX, _SMOOTH_PX)) / np.maximum(weight, 1e-6)
    rows, columns = (np.arange(_STEP_PX, size - _STEP_PX, _STRIDE) for size in depth.shape)
    grid = np.ix_(rows, columns)
    right, left = (_points(smooth, rows, columns + step, view) for step in (_STEP_PX, -_STEP_PX))
    below, above = (_points(smooth, rows + step, columns, view) for step in (_STEP_PX, -_STEP_PX))
    across, down = right - left, below - above
    middle = _points(smooth, rows, columns, view)
    good = (weight[grid] > 0.6) & (view.odds[grid] > 0)
    good &= (np.abs(across[..., 2]) < _JUMP_M) & (np.abs(down[..., 2]) < _JUMP_M)
    good &= np.abs(smooth[grid] - depth[grid]) < 0.004
    away = middle - centre
    good &= (away * away).sum(axis=-1) < radius_m**2
    normals = cross(down[good], across[good])
    normals /= np.maximum(np.sqrt(dot(normals, normals)), 1e-12)[:, None]
    return Oriented(middle[good], normals)


def _points(depth: Float32, rows: Int64, columns: Int64, view: View) -> Float64:
    """Points (rows, columns, 3) m of the pixels where `rows` and `columns` cross."""
    z = depth[np.ix_(rows, columns)].astype(np.float64)
    points = np.empty((*z.shape, 3))
    points[..., 0] = (columns - view.camera.cx) / view.camera.fx * z
    points[..., 1] = ((rows - view.camera.cy) / view.camera.fy)[:, None] * z
    points[..., 2] = z
    return points


def cube_axes(normals: Float64, starts: Float64, iterations: int = 8) -> tuple[Float64, float]:
    """The rotation (3, 3) whose axes are nearest to most normals (N, 3), and the share of normals explained.

    One of 24 that are alike. Each of the `starts` (S, 3, 3) assigns normals to axes and turns to fit them
    (orthogonal Procrustes), over again.
    """
    rotations, weights = starts, np.zeros((len(starts), len(normals)))
    for _ in range(iterations):
        rotations, weights = _turned_to(rotations, normals)
    share = weights.mean(axis=1) if len(normals) else np.zeros(len(starts))
    best = int(np.argmax(share))
    return rotations[best], float(share[best])


def _turned_to(rotations: Float64, normals: Float64) -> tuple[Float64, Float64]:
    """Rotations (S, 3, 3) turned towards the normals that are near their axes, and those weights (S, N)."""
    local = normals @ rotations
    size = np.abs(local)
    cosine = size.max(axis=-1)
    weights = tukey(np.arccos(np.minimum(cosine, 1.0)), _CUTOFF_RAD)
    nearest = np.where(size == cosine[..., None], np.sign(local), 0.0)
    spread = (weights[..., None] * nearest).swapaxes(-1, -2) @ normals
    return orthonormal(spread.swapaxes(-1, -2) + 1e-9 * rotations), weights


def free_turns(rotation: Float64, normals: Float64, count: int) -> Float64:
    """Rotations (R, 3, 3) that the normals (N, 3) tell not apart from `rotation`, itself the first.

    From a single face nothing says how the cube is turned about that face's normal.
    """
    cosines = np.abs(normals @ rotation)
    near = (cosines > np.cos(_CUTOFF_RAD)).sum(axis=0)
    main = int(np.argmax(near))
    if np.delete(near, main).max() > _SECOND_FACE * near[main]:
        return rotation[None]
    turns = np.arange(count) / count * (np.pi / 2)
    return np.stack([exponential(turn * rotation[:, main]) @ rotation for turn in turns])


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

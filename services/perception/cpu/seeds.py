"""Where in a whole frame the die might be: blobs of its colour and size, the most likely first."""

from __future__ import annotations

from typing import Any

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from services.perception.cpu.colours import bins_of
from services.perception.frames import Frame

cv2: Any = compiled_cv2  # its stubs know neither dtypes nor optional maps

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_STRIDE = 4
_NEAR_M, _FAR_M = 0.15, 1.5
_RAISED = 0.5  # what standing out of the surroundings is worth
_SCALES_M = (0.3, 0.42, 0.6, 0.85)  # distances at which the die's size in the picture is tried


def find_seeds(
    frame: Frame, odds: Float32, size_m: float, most: int, mask: NDArray[np.bool_] | None
) -> Float64:
    """Points (S, 3) m on surfaces that may be the die's, best first, at most `most`.

    A blob scores by the share of die-coloured pixels within the die's size less that around it. `odds` is the
    table (16, 16, 16) of the colours, `mask` (H, W) where to look.
    """
    colour = frame.colour[::_STRIDE, ::_STRIDE]
    depth: Float64 = frame.depth[::_STRIDE, ::_STRIDE] * np.float64(frame.depth_unit_m)
    likely = odds.ravel().take(bins_of(colour)) > 0
    if mask is not None:
        likely &= mask[::_STRIDE, ::_STRIDE]
    likely &= (depth > _NEAR_M) & (depth < _FAR_M)
    focal = float(frame.camera_matrix[0, 0]) / _STRIDE
    score = np.full(depth.shape, -1.0)
    raised = _raised(depth, focal * size_m)
    for low, scale in zip((_NEAR_M, *_SCALES_M), (*_SCALES_M, _FAR_M), strict=True):
        fitting = likely & (depth >= low) & (depth < scale * 1.2)
        width_px = focal * size_m / (0.5 * (low + scale))
        score = np.maximum(score, _blob(fitting, width_px) + _RAISED * _blob(fitting & raised, width_px))
    return _peaks(np.where(likely, score, -1.0), depth, frame.camera_matrix, focal * size_m, most)


def _raised(depth: Float64, width_m_px: float) -> NDArray[np.bool_]:
    """Where (H, W) depth is nearer than most of what is around, by half a die's size or so."""
    known = depth[depth > 0]
    middle = float(np.median(known)) if len(known) else 1.0
    side = 4 * int(width_m_px / max(middle, _NEAR_M)) | 1
    filled = np.where(depth > 0, depth, middle).astype(np.float32)
    return depth < cv2.blur(filled, (side, side)) - 0.02


def _blob(likely: NDArray[np.bool_], width_px: float) -> Float64:
    """Share (H, W) of likely pixels in a box less half the share in the ring around it."""
    inner, outer = (max(3, int(f * width_px) | 1) for f in (1.1, 2.0))
    shares = likely.astype(np.float32)
    near, wide = (cv2.boxFilter(shares, -1, (s, s), borderType=cv2.BORDER_CONSTANT) for s in (inner, outer))
    ring = (wide * outer**2 - near * inner**2) / (outer**2 - inner**2)
    return (near - 0.5 * ring).astype(np.float64)


def _peaks(score: Float64, depth: Float64, matrix: Float64, width_m_px: float, most: int) -> Float64:
    found: list[Float64] = []
    remaining = score.copy()
    v, u = np.mgrid[0 : score.shape[0], 0 : score.shape[1]]
    while len(found) < most:
        row, column = np.unravel_index(np.argmax(remaining), score.shape)
        if remaining[row, column] < 0.15:
            break
        z = float(depth[row, column])
        x = (column * _STRIDE - matrix[0, 2]) / matrix[0, 0] * z
        y = (row * _STRIDE - matrix[1, 2]) / matrix[1, 1] * z
        found.append(np.array([x, y, z]))
        remaining[(u - column) ** 2 + (v - row) ** 2 < (0.7 * width_m_px / z) ** 2] = -1.0
    return np.array(found).reshape(-1, 3)

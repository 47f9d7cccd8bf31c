"""What one frame tells about an unknown die: a face found by its shape alone, then its colours and pips.

The size of the die is known; nothing else is, not even whether pips are darker or lighter than the body.
Letters: N pixels a side of a face's picture, P points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from common.die import PIPS, Rgb
from services.perception.frames import Float64, Frame

cv2: Any = compiled_cv2  # its stubs do not know which type an array keeps

_SEED_STEP_PX = 16
_FLAT_M = 0.003  # how far points of a face may lie from its plane
_SIDE_OFF = 0.18  # how much a face's sides may differ from the die's size, as a share
_FACE_PX = 96
_INSET = 0.08  # of a side, cut off all round: rounded edges and what is beside them
_ROUND = 0.65  # least share that a pip fills of its enclosing circle
_OFF_GRID = 0.25  # of the spacing: how far a pip may be from its place


@dataclass(frozen=True)
class FaceFit:
    """A face as seen: lengths in metres, colours as the camera shows them."""

    pips: int
    body_rgb: Rgb
    pip_rgb: Rgb
    pip_radius_m: float
    pip_spacing_m: float | None  # None for a single pip
    corners_px: Float64  # (4, 2)


def fit_face(frame: Frame, size_m: float) -> FaceFit | str:
    """The face nearest to the camera that is a square of the die's size; else why there is none."""
    square = _find_square(frame, size_m)
    if square is None:
        return f"no flat square of {1e3 * size_m:.0f} mm in the depth picture: is a face towards the camera?"
    corners_px = _project(square, frame.camera_matrix)
    return _read_face(_top_view(frame.colour, corners_px), size_m, corners_px)


def _find_square(frame: Frame, size_m: float) -> Float64 | None:
    """Corners (4, 3), m, in the camera's frame."""
    depth = frame.depth_m().astype(np.float64)
    rows, columns = (np.arange(_SEED_STEP_PX, side, _SEED_STEP_PX) for side in depth.shape)
    rows, columns = np.meshgrid(rows, columns, indexing="ij")
    seeds = np.stack([rows.ravel(), columns.ravel()], axis=1)
    far = depth[seeds[:, 0], seeds[:, 1]]
    order = np.argsort(far)
    for row, column in seeds[order[far[order] > 0]]:
        corners = _square_at(depth, frame.camera_matrix, int(row), int(column), size_m)
        if corners is not None:
            return corners
    return None


def _square_at(
    depth: Float64, camera_matrix: Float64, row: int, column: int, size_m: float
) -> Float64 | None:
    """Corners (4, 3) of the square that the surface at a pixel is, if it is one."""
    reach = int(0.9 * size_m * camera_matrix[0, 0] / depth[row, column])
    top, left = max(0, row - reach), max(0, column - reach)
    window = depth[top : row + reach, left : column + reach]
    points = _points(window, camera_matrix, top, left)
    at_row, at_column, small = row - top, column - left, max(2, reach // 8)
    rows, columns = (slice(max(0, at - small), at + small) for at in (at_row, at_column))
    plane = _plane(points[rows, columns])
    if plane is None:
        return None
    part = _in_plane(window, points, plane, at_row, at_column)
    plane = _plane(points[part][:, None])  # a small patch gives a rough normal
    if plane is None:
        return None
    part = _in_plane(window, points, plane, at_row, at_column)
    if part[[0, -1]].any() or part[:, [0, -1]].any():
        return None  # it goes on beyond the window
    return _square_of(points[part], plane, size_m) if part.any() else None


def _in_plane(
    depth: Float64, points: Float64, plane: tuple[Float64, Float64], row: int, column: int
) -> NDArray[np.bool_]:
    """Where (h, w) the surface at a pixel goes on in its plane."""
    flat = (depth > 0) & (np.abs((points - plane[0]) @ plane[1]) < _FLAT_M)
    return _connected(flat, row, column)


def _connected(mask: NDArray[np.bool_], row: int, column: int) -> NDArray[np.bool_]:
    """The part of a mask that hangs together with a pixel; nothing if that pixel is not in it."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8))
    label = labels[row, column]
    return (labels == label) if label else np.zeros_like(mask)


def _points(depth: Float64, camera_matrix: Float64, top: int, left: int) -> Float64:
    """Points (h, w, 3), m, of a window of the depth picture; z is 0 where there is no reading."""
    v, u = np.mgrid[top : top + depth.shape[0], left : left + depth.shape[1]]
    x = (u - camera_matrix[0, 2]) / camera_matrix[0, 0] * depth
    y = (v - camera_matrix[1, 2]) / camera_matrix[1, 1] * depth
    return np.stack([x, y, depth], axis=-1)


def _plane(points: Float64) -> tuple[Float64, Float64] | None:
    """Centre (3,) and normal (3,) of points (h, w, 3) that have a reading."""
    known = points[points[..., 2] > 0]
    if len(known) < 12:
        return None
    centre = known.mean(axis=0)
    _, vectors = np.linalg.eigh((known - centre).T @ (known - centre))
    return centre, vectors[:, 0]


def _square_of(points: Float64, plane: tuple[Float64, Float64], size_m: float) -> Float64 | None:
    """Corners (4, 3) of the rectangle about points (P, 3) of a plane, if it is a square of that size."""
    centre, normal = plane
    right = np.cross(normal, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(normal, right)])
    (x, y), sides, angle_deg = cv2.minAreaRect(((points - centre) @ axes.T).astype(np.float32))
    if max(abs(side / size_m - 1.0) for side in sides) > _SIDE_OFF:
        return None
    turn = math.radians(angle_deg)
    along = np.array([math.cos(turn), math.sin(turn)]) * size_m / 2
    across = np.array([-along[1], along[0]])
    around = np.array([-along - across, along - across, along + across, across - along])
    return centre + (np.array([x, y]) + around) @ axes


def _project(points: Float64, camera_matrix: Float64) -> Float64:
    """Pixels (P, 2) of points (P, 3)."""
    seen = points @ camera_matrix.T
    return seen[:, :2] / seen[:, 2:]


def _top_view(colour: NDArray[np.uint8], corners_px: Float64) -> NDArray[np.uint8]:
    """The face (N, N, 3) from straight above; which way up and which way round is left open."""
    side = _FACE_PX - 1.0
    target = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
    warp = cv2.getPerspectiveTransform(corners_px.astype(np.float32), target)
    return cv2.warpPerspective(colour, warp, (_FACE_PX, _FACE_PX), flags=cv2.INTER_LINEAR)


def _read_face(view: NDArray[np.uint8], size_m: float, corners_px: Float64) -> FaceFit | str:
    edge = round(_INSET * _FACE_PX)
    inner = view[edge:-edge, edge:-edge]
    pip, colours = _two_colours(inner)
    mm_px = size_m / _FACE_PX
    blobs = _blobs(pip)
    if not 1 <= len(blobs) <= len(PIPS):
        return f"{len(blobs)} round spots on the face found, 1 to 6 expected: more light, or less glare"
    centres = (np.array([(x, y) for x, y, _ in blobs]) + edge - (_FACE_PX - 1) / 2) * mm_px
    radius_m = float(np.median([radius for *_, radius in blobs])) * mm_px
    spacing_m = _spacing(centres) if len(blobs) > 1 else None
    if len(blobs) > 1 and spacing_m is None:
        return f"{len(blobs)} spots, but not as on a die"
    body, dots = (tuple(int(level) for level in np.rint(rgb)) for rgb in colours)
    return FaceFit(len(blobs), body, dots, radius_m, spacing_m, corners_px)  # pyright: ignore[reportArgumentType]


def _two_colours(view: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], tuple[Float64, Float64]]:
    """Where (n, n) the rarer of two colours is, and the colours of body and pips as medians."""
    flat = view.reshape(-1, 3).astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    cv2.setRNGSeed(0)
    _, labels, _ = cv2.kmeans(flat, 2, None, stop, 2, cv2.KMEANS_PP_CENTERS)
    second = labels.ravel() == 1
    pip = second if second.mean() < 0.5 else ~second
    body, dots = (np.median(flat[part], axis=0).astype(np.float64) for part in (~pip, pip))
    return pip.reshape(view.shape[:2]), (body, dots)


def _blobs(pip: NDArray[np.bool_]) -> list[tuple[float, float, float]]:
    """Centre and radius, px, of the round spots of a mask."""
    contours, _ = cv2.findContours(pip.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    blobs: list[tuple[float, float, float]] = []
    for contour in contours:
        spot = cv2.drawContours(np.zeros(pip.shape, np.uint8), [contour], -1, 1, -1).astype(bool)
        rows, columns = np.nonzero(spot)
        _, reach = cv2.minEnclosingCircle(contour)
        if len(rows) >= 12 and len(rows) > _ROUND * math.pi * reach**2:
            blobs.append((float(columns.mean()), float(rows.mean()), math.sqrt(len(rows) / math.pi)))
    return blobs


def _spacing(centres: Float64) -> float | None:
    """Spacing (m) of two or more pips (P, 2) on their grid; None if they do not fit one."""
    grid = np.array(PIPS[len(centres) - 1], np.float64)
    middle = centres - centres.mean(axis=0)
    spacing = float(np.linalg.norm(middle, axis=1).sum() / np.linalg.norm(grid, axis=1).sum())
    turned = np.stack([grid[:, 1], -grid[:, 0]], axis=1)
    off = min(_farthest(middle / spacing, layout) for layout in (grid, turned))
    return spacing if off <= _OFF_GRID else None


def _farthest(points: Float64, grid: Float64) -> float:
    """The largest distance of a point (P, 2) to the nearest of the grid, and of those to the points."""
    apart = np.linalg.norm(points[:, None] - grid[None], axis=-1)
    return float(max(apart.min(axis=1).max(), apart.min(axis=0).max()))

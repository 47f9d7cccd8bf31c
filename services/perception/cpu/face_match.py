"""What a plane shows from straight above: which face of the die, how turned, and where on the plane.

Letters: K 24 labellings, G samples a side of a face, O places on the plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from services.perception.cpu.pose import Float64
from services.perception.cpu.surface import Surface
from services.perception.cpu.view import View, bilinear, project

_REACH = 9  # samples to look to each side
_WORTH = 0.08  # independent measurements a sample
_COVER = 6.0  # log-likelihood of a face that is all in sight against one that is not


class Match(NamedTuple):
    """A face of the cube at a place: the die's centre (3,) m, the labelling, and its log-likelihood."""

    centre: Float64
    label: int
    score: float


def match_face(rotation: Float64, face: int, middle: Float64, surface: Surface, view: View) -> list[Match]:
    """Best place of each labelling for a face, from 0, of a cube turned by `rotation`, near `middle`.

    `middle` (3,) m lies on the plane.
    """
    grid, reach = surface.grid, _REACH
    right, down = _raster(surface, face, rotation)
    at = np.arange(-reach, grid + reach) - (grid - 1) / 2
    points = middle + at[None, :, None] * right + at[:, None, None] * down
    pixels = project(points, view.camera)
    brightness = bilinear(view.soft, pixels).astype(np.float64)
    trust = _on_plane(points, pixels, view)
    score = _scores(brightness, trust, surface.soft.levels[:, face].reshape(len(surface.turns), -1), grid)
    rows = score.shape[0]
    matches = []
    for label in range(len(surface.turns)):
        row, column = np.unravel_index(np.argmax(score[..., label]), (rows, rows))
        shift = (column - reach) * right + (row - reach) * down
        centre = middle + shift - surface.half * (rotation @ surface.normals[face])
        matches.append(Match(centre, label, float(score[row, column, label])))
    return matches


def _raster(surface: Surface, face: int, rotation: Float64) -> tuple[Float64, Float64]:
    """How far (3,) the next sample of a face lies along a row, and down a column, camera frame."""
    points = surface.points[face]
    return rotation @ (points[1] - points[0]), rotation @ (points[surface.grid] - points[0])


def _on_plane(points: Float64, pixels: Float64, view: View) -> Float64:
    """1 where depth shows the plane and colour the die, else 0."""
    rows, columns = view.depth.shape
    nearest = np.rint(pixels).astype(np.int64)
    inside = (nearest >= 0).all(axis=-1) & (nearest[..., 0] < columns) & (nearest[..., 1] < rows)
    u, v = np.where(inside, nearest[..., 0], 0), np.where(inside, nearest[..., 1], 0)
    on_plane = np.abs(view.depth[v, u] - points[..., 2]) < 0.008
    return (inside & on_plane & (view.odds[v, u] > -1.0)).astype(np.float64)


def _scores(brightness: Float64, trust: Float64, levels: Float64, grid: int) -> Float64:
    """Log-likelihood (O, O, K) of each labelling with its face at each place."""

    def windows(picture: Float64) -> Float64:
        view = sliding_window_view(picture, (grid, grid))
        return view.reshape(*view.shape[:2], -1)

    weight, weighted = windows(trust), windows(trust * brightness)
    count = np.maximum(weight.sum(-1), 1e-9)
    mean = weighted.sum(-1) / count
    about = windows(trust * brightness**2).sum(-1) - count * mean**2
    level_sum = weight @ levels.T
    shared = weighted @ levels.T - mean[..., None] * level_sum
    spread = np.maximum(weight @ (levels**2).T - level_sum**2 / count[..., None], 1e-9)
    floor = (8.0**2 * count)[..., None]
    left = np.maximum(about[..., None] - np.maximum(shared, 0) ** 2 / spread, 0)
    explained = 0.5 * _WORTH * count[..., None] * np.log((about[..., None] + floor) / (left + floor))
    return explained + _COVER * (count / grid**2)[..., None]

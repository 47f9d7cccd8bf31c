"""Edges: where colours change along lines across the die's predicted outline and creases.

Along each line the probability of every position of the border follows from the colours on both sides of it,
as in region-based tracking (Stoiber et al., "A Sparse Gaussian Approach to Region-Based 6DoF Object
Tracking", 2020). On the outline the die's colours stand against all others, on a crease one face's against
the other's. Letters: C points on edges, D positions on a line, F 6 faces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.perception.cpu.edges import Edges, Int64, edge_jacobian, edges_of
from services.perception.cpu.pose import Pose
from services.perception.cpu.samples import Samples
from services.perception.cpu.surface import Surface
from services.perception.cpu.terms import Float64, Term
from services.perception.cpu.view import Float32, View, bilinear, colours_at

_MOST_ODDS = 2.5  # of one pixel: no table is surer than that
_STRANGEST = 4.0  # log-likelihood against a face of a pixel that has any other colour
_INSIDE_PX, _OUTSIDE_PX = 4.0, 5.0  # where depth beside an edge is read
_NEARER_M = 0.008
_FARTHER_M, _FAR_ODDS = 0.02, 1.0  # so far behind the edge is not the die: against it, in log-odds
_WIDE_PX = 10.0  # from so long a line on every other pixel is enough
_CLEAR_PX2, _NEAR_PX, _LEAST_POINTS = 6.0, 2.5, 6
_LEAST_SPREAD = 7.0  # levels
_LEAST_SAMPLES = 12.0


class FacePaint(NamedTuple):
    """Body colour of each face in this light: `mean` (F, 3) levels, `spread` (F,), infinite where unknown."""

    mean: Float64
    spread: Float64


def face_paint(samples: Samples, surface: Surface, trust: Float64, view: View) -> FacePaint:
    """Mean colour of the samples of each face that show its body, those far from it left out."""
    mean, spread = np.zeros((6, 3)), np.full(6, np.inf)
    shape = (len(samples.faces), -1)
    colours = colours_at(view, samples.pixels).reshape(*shape, 3)
    weights = trust.reshape(shape) * (surface.sharp.levels[0, samples.faces] > 0.9)
    for face, colour, weight in zip(samples.faces, colours, weights, strict=True):
        kept = weight
        for cutoff in (60.0, 30.0):
            count = kept.sum()
            if count < _LEAST_SAMPLES:
                break
            mean[face] = kept @ colour / count
            off = np.abs(colour - mean[face]).max(axis=1)
            kept = kept * (off < cutoff)
            spread[face] = max(_LEAST_SPREAD, float(kept @ off) / max(float(kept.sum()), 1.0))
    return FacePaint(mean, spread)


def border(odds: Float64, step_px: float) -> tuple[Float64, Float64]:
    """Mean (C,) px and variance (C,) px² of the border on each line, from log-odds (C, D) from inside to out.

    The border lies between two neighbouring positions; its distance is from the middle of the line.
    """
    inside = np.cumsum(odds, axis=1)
    score = np.concatenate([np.zeros((len(odds), 1)), inside], axis=1)
    chance = np.exp(2 * (score - score.max(axis=1, keepdims=True)))
    chance /= chance.sum(axis=1, keepdims=True)
    at = (np.arange(chance.shape[1]) - (chance.shape[1] - 1) / 2) * step_px
    mean = chance @ at
    return mean, chance @ at**2 - mean**2


class Borders(NamedTuple):
    """Borders `found` (C,) px across each edge, their `variance` (C,) px², and what is `free` (C,)."""

    edges: Edges
    found: Float64
    variance: Float64
    free: Float64


def search(pose: Pose, surface: Surface, view: View, paint: FacePaint, half_px: float) -> Borders:
    """Look for a border within `half_px` of each point on an edge."""
    edges = edges_of(pose, surface, view.camera)
    step_px = 1.0 if half_px < _WIDE_PX else 2.0
    steps = np.arange(-half_px, half_px + 0.5, step_px)
    lines = edges.pixels[:, None] + steps[:, None] * edges.across[:, None]
    found, variance = border(step_px * _line_odds(edges, lines, view, paint), step_px)
    return Borders(edges, found, variance, free_of_others(edges, view))


def contour_term(borders: Borders, view: View, half_px: float, outline_px: float, crease_px: float) -> Term:
    """Distances (C,) px from the edges to the borders found within `half_px` of them.

    A border is known to `outline_px` at best; on a crease to `crease_px`, for the light decides where on the
    rounded edge one face's colour becomes the other's.
    """
    edges, found, variance, free = borders
    inside = np.abs(found) < half_px - 1  # else it lies beyond what was searched
    sigma = np.where(edges.far >= 0, crease_px, outline_px)
    return Term(found, -edge_jacobian(edges, view.camera), inside * free / (sigma**2 + variance))


def edge_agreement(borders: Borders, half_px: float) -> float:
    """Share of the outline in sight where a clear border is as near as it should be; 1 where there is none.

    Where all of a line looks like the die, something of its colour may lie beside it, which says nothing.
    """
    found = borders.found
    clear = (
        (borders.edges.far < 0) & (borders.free > 0) & (borders.variance < _CLEAR_PX2) & (found < half_px - 1)
    )
    near = np.abs(found[clear]) < _NEAR_PX
    return float(near.mean()) if len(near) >= _LEAST_POINTS else 1.0


def _line_odds(edges: Edges, lines: Float64, view: View, paint: FacePaint) -> Float64:
    """Log-odds (C, D) that a position shows the near side of its edge."""
    crease = edges.far >= 0
    odds = np.empty(lines.shape[:2])
    colours = colours_at(view, lines[crease])
    near, far = (_strangeness(colours, faces[crease], paint) for faces in (edges.near, edges.far))
    odds[crease] = far - near
    rim = ~crease
    table = np.minimum(np.maximum(bilinear(view.odds, lines[rim]), -_MOST_ODDS), _MOST_ODDS)
    behind = _depth_at(view, lines[rim]) > edges.points[rim, 2:] + _FARTHER_M
    odds[rim] = table - _FAR_ODDS * behind
    return odds


def _strangeness(colours: Float64, faces: Int64, paint: FacePaint) -> Float64:
    """Minus the log-likelihood (C, D), that colours (C, D, 3) are the bodies of `faces` (C,)."""
    off = (colours - paint.mean[faces, None]) / paint.spread[faces, None, None]
    return np.minimum(0.5 * (off[..., 0] ** 2 + off[..., 1] ** 2 + off[..., 2] ** 2) / 3, _STRANGEST)


def _depth_at(view: View, pixels: Float64) -> Float32:
    """Depth (...) m of the pixels nearest to (..., 2), at the crop's rim those within; 0: no reading."""
    rows, columns = view.depth.shape
    at = np.rint(pixels).astype(np.int64)
    at = np.minimum(np.maximum(at, 0), (columns - 1, rows - 1))
    return view.depth[at[..., 1], at[..., 0]]


def free_of_others(edges: Edges, view: View) -> Float64:
    """1 for points (C,) that nothing nearer than the die covers or touches in the picture, else 0."""
    free = np.ones(len(edges.points))
    for away in (-_INSIDE_PX, _OUTSIDE_PX):
        depth = _depth_at(view, edges.pixels + away * edges.across)
        free[(depth > 0) & (depth < edges.points[:, 2] - _NEARER_M)] = 0.0
    return free

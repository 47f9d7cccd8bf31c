"""The die as the tracker sees it: samples of its faces and edges, and what each of 24 labellings would show.

Letters: F 6 faces, P samples a face, K 24 labellings, E 12 edges, M samples an edge. Metres, the die's frame.
A labelling k is a rotation S_k of the cube: the same shape, with the pips that the die shows when it is
turned by S_k first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.die import CUBE_ROTATIONS, FACES, Die

Float64 = NDArray[np.float64]

_EDGE_SHARE = 0.9  # of an edge is sampled; beyond it the search lines would meet the next edge


@dataclass(frozen=True)
class Texture:
    """What the faces show at one sharpness: 1 on the body, 0 on a pip.

    `levels` (K, F, P) of each labelling; `gradients` (F, P, 3), per metre, of labelling 0.
    """

    levels: Float64
    gradients: Float64


@dataclass(frozen=True)
class Surface:
    """Samples of a die.

    `normals` (F, 3); `points` (F, P, 3) on the flat part of each face, row by row; `core`: half the edge of
    the cube that, grown by `radius`, is the rounded die; `edges` (E, M, 3) on its edges, `along` (E, 3) their
    directions, `beside` (E, 2) the faces that meet there; `turns` (K, 3, 3) the labellings; `channel` (3,)
    the weights on RGB under which the body is brightest against the pips.
    """

    half: float
    core: float
    radius: float
    grid: int
    normals: Float64
    points: Float64
    edges: Float64
    along: Float64
    beside: NDArray[np.int64]
    turns: Float64
    sharp: Texture
    soft: Texture
    channel: Float64


def surface_of(
    die: Die, grid: int = 16, along_edge: int = 9, blurs_m: tuple[float, float] = (0.0009, 0.0025)
) -> Surface:
    """Samples of `die`: `grid`² a face, `along_edge` an edge; pips blurred by `blurs_m` (sharp, soft)."""
    core = die.half_m - die.corner_radius_m
    points = _face_points(die, grid, core)
    along, beside, edges = _edges(die, core, along_edge)
    turns = CUBE_ROTATIONS
    sharp, soft = (_texture(die, points, turns, blur) for blur in blurs_m)
    return Surface(
        half=die.half_m,
        core=core,
        radius=die.corner_radius_m,
        grid=grid,
        normals=die.normals,
        points=points,
        edges=edges,
        along=along,
        beside=beside,
        turns=turns,
        sharp=sharp,
        soft=soft,
        channel=contrast_channel(die),
    )


def contrast_channel(die: Die) -> Float64:
    """Weights (3,) on RGB under which the body is brighter than a pip by as much as it can be.

    Positive whatever the die's polarity; the weights' magnitudes sum to 1.
    """
    difference = np.array(die.body_rgb, np.float64) - np.array(die.pip_rgb, np.float64)
    return difference / np.abs(difference).sum()


def pip_share(die: Die, points: Float64, blur_m: float) -> tuple[Float64, Float64]:
    """How much (...) of a pip's ink is at `points` (..., 3) on faces, and its gradient (..., 3) per metre.

    A pip is a disc whose rim is a logistic of the standard deviation `blur_m`.
    """
    face = np.argmax(points @ die.normals.T, axis=-1)
    frames = die.frames[face]
    flat = np.einsum("...ij,...j->...i", frames[..., :2, :], points)
    share, slope = np.zeros(points.shape[:-1]), np.zeros((*points.shape[:-1], 2))
    width = blur_m * np.sqrt(3.0) / np.pi
    for number in range(FACES):
        on_face = face == number
        for pip in die.pip_offsets(number + 1):
            away = flat[on_face] - pip
            distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-9)
            ink = 1 / (1 + np.exp(np.clip((distance - die.pip_radius_m) / width, -60, 60)))
            share[on_face] += ink
            slope[on_face] -= (ink * (1 - ink) / (width * distance))[:, None] * away
    return share, np.einsum("...ij,...i->...j", frames[..., :2, :], slope)


def _texture(die: Die, points: Float64, turns: Float64, blur_m: float) -> Texture:
    levels = [1 - pip_share(die, points @ turn, blur_m)[0] for turn in turns]
    return Texture(np.stack(levels), -pip_share(die, points, blur_m)[1])


def _face_points(die: Die, grid: int, core: float) -> Float64:
    at = (np.arange(grid) + 0.5) / grid * 2 * core - core
    right, up = (x.ravel() for x in np.meshgrid(at, -at))
    plane = np.stack([right, up, np.full_like(right, die.half_m)], axis=1)
    return plane @ die.frames


def _edges(die: Die, core: float, count: int) -> tuple[Float64, NDArray[np.int64], Float64]:
    """Directions (E, 3), pairs of faces (E, 2) and samples (E, M, 3) of the core's edges."""
    normals = die.normals
    pairs = [(a, b) for a in range(FACES) for b in range(a + 1, FACES) if normals[a] @ normals[b] == 0]
    beside = np.array(pairs, np.int64)
    along = np.cross(normals[beside[:, 0]], normals[beside[:, 1]])
    middle = core * (normals[beside[:, 0]] + normals[beside[:, 1]])
    at = ((np.arange(count) + 0.5) / count * 2 - 1) * _EDGE_SHARE * core
    return along, beside, middle[:, None] + at[:, None] * along[:, None]

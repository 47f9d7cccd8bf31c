"""How simulated places look: tables, lights, fingers. Tuning and held-out sequences share none of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from common.die import FACES, Die

cv2: Any = compiled_cv2  # its stubs do not know which type an array keeps
Picture = NDArray[np.uint8]  # (N, N, 3) RGB
Colour = tuple[float, float, float]

TABLE_PIXELS = 512


@dataclass(frozen=True)
class Lighting:
    """Two lamps and what comes from everywhere; `noise` is the camera's, in grey levels."""

    key: Colour
    key_from: Colour
    fill: Colour
    fill_from: Colour
    ambient: float
    noise: float


LIGHTINGS: dict[str, Lighting] = {
    "lab": Lighting((0.55, 0.55, 0.55), (0.3, -0.5, 1.0), (0.30, 0.30, 0.30), (-0.5, 0.4, 0.8), 0.30, 1.5),
    "lamp": Lighting((0.95, 0.86, 0.70), (0.7, 0.5, 0.7), (0.05, 0.05, 0.05), (-0.4, -0.6, 0.8), 0.18, 2.0),
    "dim": Lighting((0.36, 0.40, 0.48), (-0.4, -0.6, 0.9), (0.16, 0.18, 0.22), (0.5, 0.3, 0.7), 0.20, 6.0),
}


def checker(rng: np.random.Generator) -> Picture:
    """Squares of two random colours."""
    squares = (np.indices((TABLE_PIXELS, TABLE_PIXELS)) // 32).sum(axis=0) % 2
    return rng.integers(60, 230, (2, 3), np.uint8)[squares]


def clouds(rng: np.random.Generator) -> Picture:
    """Soft blotches, like stone."""
    fields = [_smooth(rng, sigma) / weight for sigma, weight in ((40, 1), (10, 2), (2, 4))]
    return _shaded(rng, np.sum(fields, axis=0), 22.0)


def grain(rng: np.random.Generator) -> Picture:
    """Long streaks, like wood."""
    streaks = cv2.GaussianBlur(rng.standard_normal((TABLE_PIXELS, TABLE_PIXELS)), (0, 0), 60, sigmaY=1.5)
    return _shaded(rng, streaks / streaks.std(), 18.0)


def clutter(rng: np.random.Generator) -> Picture:
    """Paper, tools and boxes: overlapping rectangles, some spotted, some as white as a die."""
    picture = np.full((TABLE_PIXELS, TABLE_PIXELS, 3), rng.integers(40, 200, 3), np.uint8)
    for _ in range(90):
        centre, size = rng.uniform(0, TABLE_PIXELS, 2), rng.uniform(15, 80, 2)
        corners = cv2.boxPoints((tuple(centre), tuple(size), float(rng.uniform(0, 180)))).astype(np.int32)
        colour = rng.integers(15, 250, 3) if rng.random() < 0.7 else np.full(3, rng.integers(200, 255))
        cv2.fillPoly(picture, [corners], tuple(map(int, colour)))
        for dot in rng.uniform(corners.min(axis=0), corners.max(axis=0), (rng.integers(0, 7), 2)):
            cv2.circle(
                picture, tuple(map(int, dot)), int(rng.integers(1, 5)), tuple(map(int, 255 - colour)), -1
            )
    return picture


@dataclass(frozen=True)
class Palette:
    """What one family of sequences may look like."""

    tables: tuple[Callable[[np.random.Generator], Picture], ...]
    fingers: tuple[Colour, ...]
    palms: tuple[Colour, ...]


TUNING = Palette(
    (checker, clouds), ((0.78, 0.78, 0.78), (0.35, 0.36, 0.40)), ((0.30, 0.32, 0.36), (0.2, 0.2, 0.2))
)
HELD_OUT = Palette(
    (grain, clutter),
    ((0.82, 0.63, 0.52), (0.52, 0.55, 0.60), (0.93, 0.55, 0.25), (0.12, 0.12, 0.13), (0.86, 0.85, 0.82)),
    ((0.75, 0.56, 0.46), (0.42, 0.44, 0.47), (0.85, 0.85, 0.85), (0.10, 0.12, 0.2)),
)


def worn_atlas(die: Die, wear: float, rng: np.random.Generator, pixels: int = 160) -> Picture:
    """The die's atlas (N, F·N, 3) with paint gone from pips, scuffs, stains and darkened edges."""
    atlas = die.atlas(pixels).astype(np.float64)
    if wear <= 0:
        return atlas.astype(np.uint8)
    shape = pixels, FACES * pixels
    body = np.array(die.body_rgb, np.float64)
    gone = np.clip(_noise(rng, shape, 9.0) * wear, 0, 0.85)[..., None]
    stained = 1.0 - 0.10 * wear * np.clip(_noise(rng, shape, 30.0), 0, 2)[..., None]
    scuffs = 25.0 * wear * np.clip(np.abs(_noise(rng, shape, 1.2)) - 1.6, 0, 1)[..., None]
    at = np.abs((np.arange(pixels) + 0.5) / pixels - 0.5)
    rim = np.maximum(at[:, None], np.tile(at, FACES)[None, :])
    edges = 1.0 - 0.5 * wear * np.clip((rim - 0.42) / 0.08, 0, 1)[..., None]
    return np.clip(((1 - gone) * atlas + gone * body - scuffs) * stained * edges, 0, 255).astype(np.uint8)


def _noise(rng: np.random.Generator, shape: tuple[int, int], sigma: float) -> NDArray[np.float64]:
    field = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), sigma)
    return field / field.std()


def _smooth(rng: np.random.Generator, sigma: float) -> NDArray[np.float64]:
    return _noise(rng, (TABLE_PIXELS, TABLE_PIXELS), sigma)


def _shaded(rng: np.random.Generator, field: NDArray[np.float64], contrast: float) -> Picture:
    base = rng.uniform(70, 180, 3)
    return np.clip(base + contrast * field[..., None] * rng.uniform(0.7, 1.3, 3), 0, 255).astype(np.uint8)

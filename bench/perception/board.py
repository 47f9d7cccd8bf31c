"""A board that someone holds before the camera for a third of a second, laid over recorded frames.

So each sequence serves for trials of re-acquisition, while the die behind goes on turning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.perception.frames import Frame
from services.sim.camera import Optics

Float64 = NDArray[np.float64]

EVERY, HIDDEN_FRAMES, SLIDE_FRAMES = 60, 20, 3
_COLOUR = (128, 116, 104)
_DIE_RADIUS_M = 0.045  # of a disc about as large as the die's picture


@dataclass(frozen=True)
class Board:
    """It slides in from the right, stays, and slides out, once in EVERY frames from frame `phase` on."""

    distance_m: float  # of the die; the board is held half way
    phase: int

    def edge(self, line: int, columns: int) -> int:
        """The column where the board begins in that frame; `columns` if it is away."""
        into = (line - self.phase) % EVERY
        if line < self.phase or into >= HIDDEN_FRAMES + 2 * SLIDE_FRAMES:
            return columns
        steps = min(into + 1, HIDDEN_FRAMES + 2 * SLIDE_FRAMES - into, SLIDE_FRAMES + 1)
        return columns - round(columns * steps / (SLIDE_FRAMES + 1))

    def covers(self, centres: Float64, camera_matrix: Float64) -> Float64:
        """Which share (N,) of a die at centres (N, 3) the board hides in frames 0 to N - 1."""
        columns = Optics().width
        edges = np.array([self.edge(line, columns) for line in range(len(centres))])
        focal, middle = camera_matrix[0, 0], camera_matrix[0, 2]
        at = focal * centres[:, 0] / centres[:, 2] + middle
        radius = focal * _DIE_RADIUS_M / centres[:, 2]
        return np.where(edges < columns, np.clip((at + radius - edges) / (2 * radius), 0.0, 1.0), 0.0)

    def before(self, frame: Frame, line: int) -> Frame:
        """The frame with the board in it, and what the stereo pair loses beside it."""
        columns = frame.depth.shape[1]
        edge = self.edge(line, columns)
        if edge == columns:
            return frame
        rng = np.random.default_rng(line)
        colour, depth = frame.colour.copy(), frame.depth.copy()
        near_m = 0.5 * self.distance_m
        size = depth[:, edge:].shape
        grain = rng.integers(-4, 5, (*size, 1))
        colour[:, edge:] = np.clip(np.array(_COLOUR) + grain, 0, 255)
        depth[:, edge:] = round(near_m / frame.depth_unit_m) + rng.integers(-1, 2, size)
        depth[:, max(0, edge - self._shadow(near_m)) : edge] = 0
        return replace(frame, colour=colour, depth=depth)

    def _shadow(self, near_m: float) -> int:
        """Columns left of the board that only one of the two eyes sees, at the die's distance."""
        optics = Optics()
        return round(optics.focal_px * optics.stereo_baseline_m * (1 / near_m - 1 / self.distance_m))

"""The calibration plate: what it looks like, and where a camera sees it.

A ChArUco board. Its frame, as OpenCV's: origin in the printed board's upper left corner, x to the right, y
down, z into the plate, metres. Letters: C corners seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from common.config import Frozen
from services.perception.calibration import Dictionary
from services.perception.frames import Float64
from services.perception.tags import dictionary_of

MIN_CORNERS = 8
MIN_SHARPNESS = 300.0  # variance of the Laplacian within the plate, of levels scaled to a range of 255
MAX_PIXELS = 0.5  # root mean square reprojection error of a good view
# A small plate could be tilted the other way as well: such a second pose must fit clearly worse.
MIN_AMBIGUITY, SAME_RAD = 1.5, 0.1
_NO_DISTORTION = np.zeros(5)


class PlateConfig(Frozen):
    """The printed board."""

    squares: tuple[int, int] = Field(default=(7, 5), description="columns and rows")
    square_m: float = Field(default=0.030, gt=0.0, description="side of a square, as measured on the print")
    marker_m: float = Field(default=0.022, gt=0.0, description="side of a marker, likewise")
    dictionary: Dictionary = Field(default="DICT_5X5_100", description="of OpenCV's ArUco markers")

    @model_validator(mode="after")
    def _printable(self) -> PlateConfig:
        if min(self.squares) < 3 or self.marker_m >= self.square_m:
            raise ValueError("a plate has at least 3 x 3 squares, and markers smaller than them")
        return self


@dataclass(frozen=True)
class View:
    """A plate in one picture."""

    ids: NDArray[np.int32]  # (C,) of the corners
    pixels: Float64  # (C, 2)
    T_camera_plate: Float64  # (4, 4)
    rms_px: float  # reprojection error
    sharpness: float


class Plate:
    """Finds its corners in pictures and tells where it lies."""

    def __init__(self, config: PlateConfig) -> None:
        self.config = config
        self.board: Any = cv2.aruco.CharucoBoard(
            config.squares, config.square_m, config.marker_m, dictionary_of(config.dictionary)
        )
        self._detector = cv2.aruco.CharucoDetector(self.board)
        self._corners: Float64 = np.asarray(self.board.getChessboardCorners(), np.float64)

    def look(self, colour: NDArray[np.uint8], camera_matrix: Float64) -> View | str:
        """The plate in a picture (H, W, 3), RGB; or, in a few words, why it cannot be used."""
        grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
        corners, ids, _, _ = self._detector.detectBoard(grey)
        found = 0 if ids is None else len(ids)
        if found < MIN_CORNERS:
            return f"{found} corners seen, {MIN_CORNERS} wanted"
        numbers = np.asarray(ids, np.int32).ravel()
        pixels = np.asarray(corners, np.float64).reshape(-1, 2)
        sharp = _sharpness(grey, pixels)
        if sharp < MIN_SHARPNESS:
            return f"blurred: sharpness {sharp:.0f}, {MIN_SHARPNESS:.0f} wanted"
        pose = self.pose(numbers, pixels, camera_matrix)
        if isinstance(pose, str):
            return pose
        return View(numbers, pixels, *pose, sharp)

    def pose(
        self, ids: NDArray[np.int32], pixels: Float64, camera_matrix: Float64
    ) -> tuple[Float64, float] | str:
        """`T_camera_plate` (4, 4) and the reprojection error of corners (C,), (C, 2); or what is wrong."""
        points = self._corners[ids]
        if np.linalg.matrix_rank(points - points.mean(axis=0), tol=self.config.square_m / 2) < 2:
            return "all corners seen are in one line"
        found, turns, moves, errors = cv2.solvePnPGeneric(
            points, pixels, camera_matrix, _NO_DISTORTION, flags=cv2.SOLVEPNP_IPPE
        )
        rms = np.ravel(np.asarray(errors, np.float64))
        if not found:
            return "no pose fits the corners"
        if len(rms) > 1 and rms[1] < MIN_AMBIGUITY * rms[0] and _angle(turns[0], turns[1]) > SAME_RAD:
            return "so small or flat in the picture that its tilt cannot be told: tilt it or come nearer"
        turn, move = cv2.solvePnPRefineLM(
            points, pixels, camera_matrix, _NO_DISTORTION, turns[0].copy(), moves[0].copy()
        )
        error = reprojection(points, pixels, turn, move, camera_matrix)
        if error > MAX_PIXELS:
            return f"corners are {error:.2f} px off the best pose, at most {MAX_PIXELS}: another plate or K?"
        return transform_of(turn, move), error

    def picture(self, pixels_per_m: float) -> NDArray[np.uint8]:
        """The plate (H, W) to be printed, without a margin."""
        size = [round(n * self.config.square_m * pixels_per_m) for n in self.config.squares]
        return self.board.generateImage(size, marginSize=0)

    def corners(self, ids: Sequence[int] | NDArray[np.int32]) -> Float64:
        """Where corners (C,) are on the plate: (C, 3) m."""
        return self._corners[np.asarray(ids)]


def reprojection(points: Float64, pixels: Float64, turn: Any, move: Any, camera_matrix: Float64) -> float:
    """Root mean square distance, px, of points (C, 3) projected from where they are seen (C, 2)."""
    projected, _ = cv2.projectPoints(points, turn, move, camera_matrix, _NO_DISTORTION)
    return float(np.sqrt(np.mean(np.sum((projected.reshape(-1, 2) - pixels) ** 2, axis=1))))


def transform_of(turn: Any, move: Any) -> Float64:
    """OpenCV's rotation vector and translation as a transform (4, 4)."""
    transform = np.eye(4)
    transform[:3, :3] = cv2.Rodrigues(turn)[0]
    transform[:3, 3] = np.ravel(move)
    return transform


def _angle(turn: Any, other: Any) -> float:
    both = cv2.Rodrigues(turn)[0].T @ cv2.Rodrigues(other)[0]
    return float(np.linalg.norm(cv2.Rodrigues(both)[0]))


def _sharpness(grey: Any, pixels: Float64) -> float:
    """Variance of the Laplacian in the box around the corners, as if the light used the whole range."""
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    high = np.ceil(pixels.max(axis=0)).astype(int) + 1
    inside = grey[low[1] : high[1], low[0] : high[0]]
    span = float(np.ptp(inside)) or 1.0
    return float(cv2.Laplacian(inside, cv2.CV_64F).var()) * (255 / span) ** 2

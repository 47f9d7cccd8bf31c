"""The camera of an emulated hand: where it is and what it sees; shared by who draws and who looks."""

# pyright: strict

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from common.config import Frozen


class CameraConfig(Frozen):
    """Intrinsics as of a real D435 at 640 x 480.

    It is 0.41 m from the die as laid in, on the side of the wrist and the little finger: fingers and thumb
    close from the others, and three faces show.
    """

    width: int = Field(default=640, ge=64, le=1280, description="px")
    height: int = Field(default=480, ge=64, le=960, description="px")
    focal_px: float = Field(default=613.2, gt=0.0)
    centre_px: tuple[float, float] = (321.4, 241.7)
    eye_m: tuple[float, float, float] = Field(
        default=(0.36, -0.17, -0.06), description="where it is, in the palm's frame"
    )
    target_m: tuple[float, float, float] = Field(
        default=(0.055, 0.0, 0.154), description="what it looks at, likewise"
    )
    rate_hz: float = Field(default=10.0, gt=0.0, le=60.0, description="pictures a second")
    shadows: bool = Field(default=False, description="draw them: 48 ms of a core a picture instead of 19")

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        if np.linalg.norm(np.subtract(self.target_m, self.eye_m)) < 0.05:
            raise ValueError("camera: eye_m and target_m must be apart")
        return self

    @property
    def camera_matrix(self) -> NDArray[np.float64]:
        """K (3, 3)."""
        cx, cy = self.centre_px
        return np.array([[self.focal_px, 0.0, cx], [0.0, self.focal_px, cy], [0.0, 0.0, 1.0]])

    @property
    def T_palm_camera(self) -> NDArray[np.float64]:  # noqa: N802 - as everywhere in perception
        """From the camera's frame, x right, y down, z forward, to the palm's: (4, 4); fingertips are up."""
        eye = np.array(self.eye_m)
        forward = np.subtract(self.target_m, eye)
        forward = forward / np.linalg.norm(forward)
        fingertips = np.array([0.0, 0.0, 1.0])
        right = np.cross(forward, fingertips)
        right = right / np.linalg.norm(right)
        transform = np.eye(4)
        transform[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        transform[:3, 3] = eye
        return transform

"""Where the camera is, as a file: K, serial number, pose in the palm's frame, residuals, palm tag."""

# pyright: strict

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import yaml
from pydantic import Field, model_validator

from common.config import Frozen
from services.perception import rigid
from services.perception.frames import Float64, check_camera_matrix

Numbers3 = tuple[float, float, float]
Numbers4 = tuple[float, float, float, float]
Pixel = tuple[float, float]
Case = Literal["jig", "hand_eye", "robot_world"]
# Of OpenCV's many marker dictionaries, small ones that are hard to mistake.
Dictionary = Literal["DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_APRILTAG_36h11"]

SAME_K_SHARE = 0.002  # of a focal length or a centre: another stream of the camera differs by more


class Pose(Frozen):
    """Something's pose in a frame that the context names."""

    position_m: Numbers3 = (0.0, 0.0, 0.0)
    rotation: Numbers4 = Field(default=(1.0, 0.0, 0.0, 0.0), description="quaternion wxyz")

    @model_validator(mode="after")
    def _is_a_rotation(self) -> Self:
        if abs(float(np.linalg.norm(self.rotation)) - 1.0) > 1e-3:
            raise ValueError("rotation must have norm 1")
        return self

    @property
    def transform(self) -> Float64:
        """The same as (4, 4)."""
        return rigid.join(self.position_m, np.array(self.rotation) / np.linalg.norm(self.rotation))

    @classmethod
    def of(cls, transform: Float64) -> Self:
        """The pose of a transform (4, 4)."""
        position, rotation = rigid.split(transform)
        (x, y, z), (a, b, c, d) = position.tolist(), rotation.tolist()
        return cls(position_m=(x, y, z), rotation=(a, b, c, d))


class Residuals(Frozen):
    """How well it fits. Position and rotation: of a view's plate from where the other views put it."""

    views: int = Field(ge=1)
    pixels_rms: float = Field(ge=0.0, description="px, of all corners")
    position_mm: float = Field(ge=0.0, description="root mean square")
    rotation_deg: float = Field(ge=0.0, description="root mean square")


class TagReference(Frozen):
    """A tag that is fixed to the palm, and where the camera saw it when it was calibrated."""

    dictionary: Dictionary = "DICT_4X4_50"
    number: int = Field(default=0, ge=0)
    corners_px: Annotated[tuple[Pixel, ...], Field(min_length=4, max_length=4)]


class Calibration(Frozen):
    """One camera at one place."""

    serial: str = Field(description="of the camera; empty: not told")
    date: str
    case: Case
    image_size: tuple[int, int] = Field(description="width and height, px")
    camera_matrix: tuple[Numbers3, Numbers3, Numbers3]
    camera_in_palm: Pose = Field(description="of the colour camera's optical frame, in the palm's")
    residuals: Residuals
    tag: TagReference | None = None

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        check_camera_matrix(self.K)
        return self

    @property
    def K(self) -> Float64:  # noqa: N802 - the field's name for it
        """Camera matrix (3, 3)."""
        return np.array(self.camera_matrix, np.float64)

    @property
    def T_palm_camera(self) -> Float64:  # noqa: N802 - the field's name for it
        """From the camera's frame to the palm's: (4, 4)."""
        return self.camera_in_palm.transform

    def misfit(self, camera_matrix: Float64) -> str:
        """What is wrong when pictures come with that K (3, 3); empty if it is the one calibrated."""
        off = float(np.abs(camera_matrix - self.K).max() / self.K[0, 0])
        if off <= SAME_K_SHARE:
            return ""
        fx, fy, cx, cy = (camera_matrix[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return (
            f"pictures have fx {fx:.1f} fy {fy:.1f} cx {cx:.1f} cy {cy:.1f}, calibrated were "
            f"{self.K[0, 0]:.1f} {self.K[1, 1]:.1f} {self.K[0, 2]:.1f} {self.K[1, 2]:.1f}: "
            "use the resolution that was calibrated, or calibrate anew"
        )

    def save(self, path: Path) -> None:
        """Write it as YAML."""
        path.write_text(yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False), encoding="utf-8")

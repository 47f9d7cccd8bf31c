"""Does a calibration still hold? Same K, the palm's tag where it was, the jigged plate where it should be."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from services.perception import rigid
from services.perception.calibration import Calibration
from services.perception.config import KnockConfig
from services.perception.frames import Frame
from services.perception.plate import Plate, View
from services.perception.rig import RigConfig
from services.perception.tags import TagFinder

PLATE_MM, PLATE_DEG = 2.0, 0.5
AXES_M = 0.05
_RGB = ((255, 60, 60), (60, 200, 60), (80, 120, 255))  # x, y, z


@dataclass(frozen=True)
class Finding:
    """One line for people; what could not be seen is neither right nor wrong."""

    ok: bool
    text: str

    def __str__(self) -> str:
        """Lay the line out."""
        return f"{'ok  ' if self.ok else 'FAIL'}  {self.text}"


def verify(rig: RigConfig, calibration: Calibration, frame: Frame) -> list[Finding]:
    """Judge a frame of the working cell; one that shows neither tag nor plate does not pass."""
    misfit = calibration.misfit(frame.camera_matrix)
    findings = [Finding(not misfit, misfit or "intrinsics are those calibrated")]
    places = [*_tag(calibration, frame), *_plate(rig, calibration, frame)]
    nothing = Finding(
        False, "neither the palm's tag nor the jigged plate is in the picture: show one of them"
    )
    return [*findings, *(places or [nothing])]


def _tag(calibration: Calibration, frame: Frame) -> list[Finding]:
    reference = calibration.tag
    if reference is None:
        return []
    tags = TagFinder(reference.dictionary).find(frame.colour)
    seen = [tag.pixels for tag in tags if tag.number == reference.number]
    if not seen:
        return []
    offset = float(np.linalg.norm(seen[0] - np.array(reference.corners_px), axis=1).mean())
    limit = KnockConfig().limit_px
    return [Finding(offset <= limit, f"palm's tag {offset:.1f} px from where it was, at most {limit:g}")]


def _plate(rig: RigConfig, calibration: Calibration, frame: Frame) -> list[Finding]:
    view = Plate(rig.plate).look(frame.colour, frame.camera_matrix)
    if rig.jig is None or not isinstance(view, View):
        return []
    offset = rigid.inverse(rig.jig.transform) @ calibration.T_palm_camera @ view.T_camera_plate
    position_mm = 1e3 * float(np.linalg.norm(offset[:3, 3]))
    rotation_deg = float(np.degrees(np.linalg.norm(cv2.Rodrigues(offset[:3, :3])[0])))
    ok = position_mm <= PLATE_MM and rotation_deg <= PLATE_DEG
    limits = f"at most {PLATE_MM:g} and {PLATE_DEG:g}"
    return [Finding(ok, f"plate {position_mm:.1f} mm, {rotation_deg:.2f} deg from its jig, {limits}")]


def drawn(calibration: Calibration, frame: Frame) -> NDArray[np.uint8]:
    """The picture (H, W, 3), RGB, with the palm's axes (x red, y green, z blue) and the tag's place."""
    picture = frame.colour.copy()
    T_camera_palm = rigid.inverse(calibration.T_palm_camera)
    tips = np.concatenate([np.zeros((1, 3)), AXES_M * np.eye(3)])
    points = (tips @ T_camera_palm[:3, :3].T + T_camera_palm[:3, 3]) @ calibration.K.T
    origin, *ends = [(round(x / z), round(y / z)) for x, y, z in points.tolist()]
    for end, rgb in zip(ends, _RGB, strict=True):
        cv2.line(picture, origin, end, rgb, 2, cv2.LINE_AA)
    if calibration.tag is not None:
        corners = np.rint(np.array(calibration.tag.corners_px)).astype(np.int32)
        cv2.polylines(picture, [corners], True, (255, 220, 0), 1, cv2.LINE_AA)
    return picture

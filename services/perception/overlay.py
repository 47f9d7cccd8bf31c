"""Pictures for people: the die as it is believed to lie, its face numbers, and depth as brightness."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.camera_messages import PoseState
from common.die import FACES, Die, Rgb
from services.perception.backend import PoseEstimate
from services.perception.frames import Float64, Frame

NEAREST_M, FARTHEST_M = 0.2, 1.0  # of the depth picture: white, nearly black
RGB = {
    PoseState.TRACKING: (60, 220, 90),
    PoseState.SUSPECT: (255, 190, 40),
    PoseState.SEARCHING: (150, 150, 160),
    PoseState.LOST: (255, 70, 70),
}
_TEXT_PX = 18
_BESIDE = ((1, 1), (1, -1), (-1, -1), (-1, 1))


def annotated(
    frame: Frame, die: Die, estimate: PoseEstimate | None, state: PoseState, text: str
) -> NDArray[np.uint8]:
    """The frame's colour (H, W, 3), RGB, with the die's visible faces outlined and numbered, below a line.

    Colours tell the state; a pose that is not claimed is drawn with thin lines.
    """
    picture = frame.colour.copy()
    rgb = RGB[state]
    if estimate is not None:
        _draw_die(picture, die, estimate, frame.camera_matrix, rgb)
    cv2.rectangle(picture, (0, 0), (picture.shape[1], _TEXT_PX + 6), (20, 22, 28), -1)
    line = f"{state.value}  {text}".rstrip()
    cv2.putText(picture, line, (6, _TEXT_PX), cv2.FONT_HERSHEY_SIMPLEX, 0.45, rgb, 1, cv2.LINE_AA)
    return picture


def _draw_die(
    picture: NDArray[np.uint8], die: Die, estimate: PoseEstimate, camera_matrix: Float64, rgb: Rgb
) -> None:
    rotation, centre = estimate.T_camera_die[:3, :3], estimate.T_camera_die[:3, 3]
    width = 2 if estimate.claimed else 1
    if centre[2] <= die.size_m:
        return
    for face in range(FACES):
        right, up, outward = die.frames[face] @ rotation.T
        middle = centre + die.half_m * outward
        if outward @ middle >= 0:  # turned away
            continue
        corners = np.array([middle + die.half_m * (x * right + y * up) for x, y in _BESIDE])
        outline = np.rint(_pixels(corners, camera_matrix)).astype(np.int32)
        cv2.polylines(picture, [outline], True, rgb, width, cv2.LINE_AA)
        u, v = _pixels(middle[None], camera_matrix)[0]
        where = (round(u) - 8, round(v) + 8)
        for colour, thickness in (((0, 0, 0), 4), (rgb, 2)):
            cv2.putText(
                picture, str(face + 1), where, cv2.FONT_HERSHEY_SIMPLEX, 0.8, colour, thickness, cv2.LINE_AA
            )


def _pixels(points: Float64, camera_matrix: Float64) -> Float64:
    seen = points @ camera_matrix.T
    return seen[:, :2] / seen[:, 2:]


def depth_picture(frame: Frame) -> NDArray[np.uint8]:
    """Depth (H, W) as brightness, linear in its inverse as disparity is; black where there is none."""
    depth = frame.depth_m()
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    low, high = 1 / FARTHEST_M, 1 / NEAREST_M
    return np.where(depth > 0, np.clip(30 + 225 * (inverse - low) / (high - low), 30, 255), 0).astype(
        np.uint8
    )


def jpeg(picture: NDArray[np.uint8], quality: int = 80) -> bytes:
    """A picture (H, W, 3), RGB, or (H, W) as a JPEG file."""
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else picture
    return cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, quality))[1].tobytes()

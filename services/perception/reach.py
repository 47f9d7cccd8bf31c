"""Where the die can be: within reach of the hand. What lies beyond, a second die too, is not searched."""

# pyright: strict

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from services.perception.config import ReachConfig
from services.perception.frames import Float64, Frame

_STRIDE = 4
_GROW = 3  # coarse pixels by which the mask grows: at edges depth is missing


class Reach:
    """The ball, seen from the camera."""

    def __init__(self, config: ReachConfig, T_palm_camera: Float64) -> None:
        self._radius_m, self._believed_m = config.radius_m, config.believed_m
        self._centre_palm = np.array(config.centre_m)
        self._centre: Float64 = T_palm_camera[:3, :3].T @ (self._centre_palm - T_palm_camera[:3, 3])

    def mask(self, frame: Frame) -> NDArray[np.bool_] | str:
        """Pixels (H, W) whose depth is within the ball; or, when there are none, what that means."""
        depth = frame.depth[::_STRIDE, ::_STRIDE] * frame.depth_unit_m
        rows, columns = np.indices(depth.shape) * _STRIDE
        fx, fy, cx, cy = (frame.camera_matrix[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
        away = (
            np.stack([(columns - cx) / fx * depth, (rows - cy) / fy * depth, depth], axis=-1) - self._centre
        )
        near = ((away**2).sum(axis=-1) < self._radius_m**2) & (depth > 0)
        if not near.any():
            return "nothing within reach of the hand: is the camera aimed and calibrated?"
        grown = cv2.dilate(near.astype(np.uint8), np.ones((_GROW, _GROW), np.uint8))
        height, width = frame.depth.shape
        return cv2.resize(grown, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.bool_)

    def doubt(self, position: Float64) -> str:
        """Why a die at a position (3,) of the palm's frame cannot be the one; empty if it can."""
        distance_m = float(np.linalg.norm(position - self._centre_palm))
        if distance_m <= self._believed_m:
            return ""
        return f"a die {distance_m:.2f} m from the hand is not the one: take it out of view"

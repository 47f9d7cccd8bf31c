"""The part of a frame around the die, prepared once so that each iteration only samples it.

Coordinates are those of the crop: pixel (0, 0) is the centre of its upper left pixel, `camera` has been
shifted to match. Depth is aligned to colour, in metres; 0 means none.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from services.perception.cpu.pose import Pose
from services.perception.cpu.surface import Surface
from services.perception.frames import Frame

cv2: Any = compiled_cv2  # its stubs know neither dtypes nor optional maps

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


class Camera(NamedTuple):
    """Pinhole of a crop: focal lengths and principal point, px."""

    fx: float
    fy: float
    cx: float
    cy: float


class View(NamedTuple):
    """A crop (H, W): its `colour` (H, W, 3), `sharp` and `soft` brightness along the die's contrast, `odds`

    log P(die) / P(not) of its colours, and `depth` m.
    """

    camera: Camera
    colour: NDArray[np.uint8]
    sharp: Float32
    soft: Float32
    odds: Float32
    depth: Float32


class Crop(NamedTuple):
    """A rectangle of a picture, px: columns [left, right), rows [top, bottom)."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def window(self) -> tuple[slice, slice]:
        """Index of its rows and columns."""
        return slice(self.top, self.bottom), slice(self.left, self.right)


def crop_around(pose: Pose, camera: Camera, size: tuple[int, int], reach_m: float, margin_px: int) -> Crop:
    """Where a ball of `reach_m` about the die shows in a picture of `size` (rows, columns), with a margin.

    Empty where the die is behind the camera or out of view.
    """
    x, y, z = pose.translation
    if z <= reach_m:
        return Crop(0, 0, 0, 0)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    half = max(camera.fx, camera.fy) * reach_m / z + margin_px
    rows, columns = size
    left, right = (int(np.clip(round(edge), 0, columns)) for edge in (u - half, u + half))
    top, bottom = (int(np.clip(round(edge), 0, rows)) for edge in (v - half, v + half))
    return Crop(left, top, right, bottom)


def view_of(frame: Frame, camera: Camera, crop: Crop, odds: Float32, channel: Float64) -> View:
    """Prepare a crop of a frame; `odds` (16, 16, 16) is a table by RGB, `channel` (3,) are weights on RGB."""
    colour = np.ascontiguousarray(frame.colour[crop.window])
    sharp = cv2.transform(colour.astype(np.float32), channel.astype(np.float32)[None, :])
    sharp = cv2.GaussianBlur(sharp, (3, 3), 0.7)
    soft = cv2.GaussianBlur(sharp, (9, 9), 2.2)
    shifted = Camera(camera.fx, camera.fy, camera.cx - crop.left, camera.cy - crop.top)
    depth = frame.depth[crop.window] * np.float32(frame.depth_unit_m)
    return View(shifted, colour, sharp, soft, look_up(odds, colour), depth)


def look_up(table: Float32, colour: NDArray[np.uint8]) -> Float32:
    """Values (H, W) of a table (16, 16, 16) at colours (H, W, 3), smoothed over 3x3 pixels."""
    bins = np.right_shift(colour, 4).astype(np.int32)
    index = (bins[..., 0] << 8) | (bins[..., 1] << 4) | bins[..., 2]
    return cv2.blur(table.ravel().take(index), (3, 3))


def project(points: Float64, camera: Camera) -> Float64:
    """Pixels (..., 2) of points (..., 3) in front of the camera."""
    scale = 1 / points[..., 2]
    pixels = np.empty((*points.shape[:-1], 2))
    pixels[..., 0] = camera.fx * points[..., 0] * scale + camera.cx
    pixels[..., 1] = camera.fy * points[..., 1] * scale + camera.cy
    return pixels


def bilinear(picture: Float32, pixels: Float64) -> Float32:
    """Values (...) of a picture at pixels (..., 2); outside it the nearest pixel's."""
    if not pixels.size:
        return np.empty(pixels.shape[:-1], np.float32)
    at = pixels.reshape(1, -1, 2).astype(np.float32)
    return cv2.remap(picture, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(
        pixels.shape[:-1]
    )


def colours_at(view: View, pixels: Float64) -> Float64:
    """Colours (..., 3) of the crop at pixels (..., 2), interpolated."""
    if not pixels.size:
        return np.empty((*pixels.shape[:-1], 3))
    at = pixels.reshape(1, -1, 2).astype(np.float32)
    colours = cv2.remap(view.colour, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return colours.reshape(*pixels.shape[:-1], 3).astype(np.float64)


def visible_faces(pose: Pose, surface: Surface, least: float = 0.12) -> NDArray[np.int64]:
    """Numbers (V,) from 0 of the faces that are turned to the camera by a cosine of more than `least`."""
    normals = surface.normals @ pose.rotation.T
    centres = pose.translation + surface.half * normals
    facing = -(normals * centres).sum(axis=1) / np.sqrt((centres * centres).sum(axis=1))
    return np.flatnonzero(facing > least)


def colours_around(view: View, centre: Float64, radius_m: float) -> NDArray[np.uint8]:
    """Colours (N, 3) of every ninth pixel of a crop that is outside a ball about `centre` (3,)."""
    rows, columns = view.depth.shape
    x, y, z = centre
    u = (np.arange(0, columns, 3) - view.camera.cx) / view.camera.fx - x / z
    v = (np.arange(0, rows, 3) - view.camera.cy) / view.camera.fy - y / z
    outside = u[None, :] ** 2 + v[:, None] ** 2 > (radius_m / z) ** 2
    return view.colour[::3, ::3][outside]

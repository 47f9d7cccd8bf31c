"""Exact pictures of flat printed things: textures laid into a camera's view by their homography."""

import cv2
import numpy as np

from services.perception import rigid

CAMERA_MATRIX = np.array([[613.0, 0.0, 322.0], [0.0, 613.0, 238.0], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 640, 480
GROUND = 90
_OVER = 3  # drawn at so many times the size, then averaged: as a pixel does


def looking(position, towards=(0.0, 0.0, 0.0), roll_rad=0.0):
    """`T_camera_world` (4, 4) of a camera at a position that looks at a point, x nearly horizontal."""
    forward = np.subtract(towards, position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0) if abs(forward[2]) < 0.99 else (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    axes = np.stack([c * right + s * down, c * down - s * right, forward])
    world = np.eye(4)
    world[:3, :3] = axes.T
    world[:3, 3] = position
    return rigid.inverse(world)


def lay(canvas, texture, T_camera_print, size_m, centred):
    """Draw a texture (h, w) of a print of (width, height) m onto the enlarged canvas.

    The print's frame has x right and y down as printed; its origin is the upper left corner or, `centred`,
    the middle.
    """
    height, width = texture.shape
    scale_x, scale_y = size_m[0] / width, size_m[1] / height
    origin = np.array([-size_m[0] / 2, -size_m[1] / 2]) if centred else np.zeros(2)
    # Texture pixel centres are at whole numbers; the print's edge is half a pixel before the first.
    to_print = np.array(
        [[scale_x, 0, origin[0] + scale_x / 2], [0, scale_y, origin[1] + scale_y / 2], [0, 0, 1]]
    )
    to_pixel = CAMERA_MATRIX @ T_camera_print[:3][:, [0, 1, 3]]
    enlarge = np.array([[_OVER, 0, (_OVER - 1) / 2], [0, _OVER, (_OVER - 1) / 2], [0, 0, 1.0]])
    homography = enlarge @ to_pixel @ to_print
    corners = np.array([[[-1, -1], [width, -1], [width, height], [-1, height]]], np.float64)
    box = cv2.perspectiveTransform(corners, homography)[0]
    limits = canvas.shape[1], canvas.shape[0]
    low = np.clip(np.floor(box.min(axis=0)), 0, limits).astype(int)
    high = np.clip(np.ceil(box.max(axis=0)), 0, limits).astype(int)
    size = tuple((high - low).tolist())
    if min(size) == 0:
        return
    homography = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1.0]]) @ homography
    drawn = cv2.warpPerspective(texture, homography, size, flags=cv2.INTER_AREA)
    covered = cv2.warpPerspective(np.full_like(texture, 255), homography, size, flags=cv2.INTER_NEAREST) > 127
    canvas[low[1] : high[1], low[0] : high[0]][covered] = drawn[covered]


def blank():
    return np.full((HEIGHT * _OVER, WIDTH * _OVER), GROUND, np.uint8)


def shrunk(canvas):
    """The canvas at the camera's size (H, W), as a pixel averages."""
    return cv2.resize(canvas, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def noisy(grey, noise, seed):
    """A colour picture (H, W, 3) of a grey one, with normal noise."""
    levels = grey + noise * np.random.default_rng(seed).standard_normal(grey.shape, np.float32)
    return np.repeat(np.clip(np.rint(levels), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def developed(canvas, noise=0.0, seed=0):
    """The canvas as a camera's colour picture (H, W, 3)."""
    return noisy(shrunk(canvas), noise, seed)


def plate_picture(plate, T_camera_plate, noise=2.0, seed=0):
    canvas = blank()
    config = plate.config
    size_m = tuple(n * config.square_m for n in config.squares)
    lay(canvas, plate.picture(8000), T_camera_plate, size_m, centred=False)
    return developed(canvas, noise, seed)

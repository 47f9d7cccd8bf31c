"""Samples of the faces that a pose lets the camera see, and what the frame has there.

Letters: V visible faces, N samples, of all visible faces one after another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.perception.cpu.pose import Pose
from services.perception.cpu.surface import Surface
from services.perception.cpu.view import View, project, visible_faces

Float64 = NDArray[np.float64]


class Samples(NamedTuple):
    """Points on visible faces, camera frame, and the depth seen there.

    `faces` (V,); `normals` (V, 3); `arms` (N, 3) m from the die's centre; `points` (N, 3) m; `pixels` (N, 2);
    `rays` (N, 3), with z = 1, of the pixel that depth was read from; `seen` (N,) m, 0: no reading;
    `behind` (N,) m, by how much depth lies behind the face along that ray, NaN where none was read.
    """

    faces: NDArray[np.int64]
    normals: Float64
    arms: Float64
    points: Float64
    pixels: Float64
    rays: Float64
    seen: Float64
    behind: Float64

    def per_sample(self, values: Float64) -> Float64:
        """Values (V, ...) of the faces, repeated for each of their samples (N, ...)."""
        return np.repeat(values, len(self.points) // max(1, len(self.faces)), axis=0)


def sample_faces(pose: Pose, surface: Surface, view: View) -> Samples:
    """Samples of all faces that `pose` shows, with the frame's depth."""
    faces = visible_faces(pose, surface)
    normals = surface.normals[faces] @ pose.rotation.T
    arms = surface.points[faces].reshape(-1, 3) @ pose.rotation.T
    points = arms + pose.translation
    pixels = project(points, view.camera)
    rays, seen = _read_depth(pixels, view)
    per_face = surface.points.shape[1]
    reach = np.repeat(normals @ pose.translation + surface.half, per_face)
    slant = (rays.reshape(len(faces), per_face, 3) @ normals[:, :, None]).ravel()
    behind = np.where(seen > 0, seen - reach / np.minimum(slant, -1e-3), np.nan)
    return Samples(faces, normals, arms, points, pixels, rays, seen, behind)


def _read_depth(pixels: Float64, view: View) -> tuple[Float64, Float64]:
    """Rays (N, 3) and depth (N,) m of the nearest pixels; no depth outside the crop."""
    rows, columns = view.depth.shape
    nearest = np.rint(pixels).astype(np.int64)
    u, v = nearest[:, 0], nearest[:, 1]
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    seen = view.depth[np.where(inside, v, 0), np.where(inside, u, 0)] * inside
    rays = np.ones((len(pixels), 3))
    rays[:, 0] = (u - view.camera.cx) / view.camera.fx
    rays[:, 1] = (v - view.camera.cy) / view.camera.fy
    return rays, seen.astype(np.float64)

"""Edges of the die in the picture: its outline, and the creases between faces that are both in sight.

The outline of a rounded cube is that of its core cube, moved outward by the corner radius.
Letters: C points on edges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.perception.cpu.pose import Pose
from services.perception.cpu.surface import Surface
from services.perception.cpu.terms import Float64, cross, dot
from services.perception.cpu.view import Camera, project

Int64 = NDArray[np.int64]


class Edges(NamedTuple):
    """Points (C, ·) on edges in sight; `across` points from face `near` to face `far`, or out of the die.

    `arms` (C, 3) m from the die's centre, `points` (C, 3) m, `pixels` (C, 2), unit `across` (C, 2) in the
    picture; `near` and `far` (C,) are faces from 0, `far` is -1 on the outline.
    """

    arms: Float64
    points: Float64
    pixels: Float64
    across: Float64
    near: Int64
    far: Int64


def edges_of(pose: Pose, surface: Surface, camera: Camera) -> Edges:
    """All edges of which at least one face is in sight."""
    normals = surface.normals @ pose.rotation.T
    in_sight = normals @ pose.translation + surface.half < 0
    first, second = surface.beside.T
    shown = in_sight[first] | in_sight[second]
    first, second = first[shown], second[shown]
    near = np.where(in_sight[first], first, second)
    far = np.where(in_sight[first] & in_sight[second], second, -1)
    count = surface.edges.shape[1]
    core = surface.edges[shown].reshape(-1, 3) @ pose.rotation.T
    along = np.repeat(surface.along[shown] @ pose.rotation.T, count, axis=0)
    ridge = np.repeat(normals[first] + normals[second], count, axis=0)
    step = np.repeat(normals[second] - normals[first], count, axis=0)
    near, far = np.repeat(near, count), np.repeat(far, count)
    outward = _rim(along, core, pose.translation)
    crease = (far >= 0)[:, None]
    arms = core + surface.radius * np.where(crease, ridge * np.sqrt(0.5), outward)
    points = arms + pose.translation
    across = _square(
        pixel_motion(points, along, camera), pixel_motion(points, np.where(crease, step, outward), camera)
    )
    return Edges(arms, points, project(points, camera), across, near, far)


def _rim(along: Float64, core: Float64, centre: Float64) -> Float64:
    """Unit directions (C, 3) from edges of the core to where a ray just touches the rounded edge."""
    outward = cross(along, core + centre)
    length = np.sqrt(dot(outward, outward)) * np.where(dot(outward, core) < 0, -1.0, 1.0)
    return outward / length[:, None]


def _square(along: Float64, towards: Float64) -> Float64:
    """Unit vectors (C, 2) across directions `along` (C, 2), on the side of `towards` (C, 2)."""
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    length = np.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2)
    length *= np.where(across[:, 0] * towards[:, 0] + across[:, 1] * towards[:, 1] < 0, -1.0, 1.0)
    return across / length[:, None]


def pixel_motion(points: Float64, velocities: Float64, camera: Camera) -> Float64:
    """How pixels (C, 2) move when points (C, 3) move by `velocities` (C, 3)."""
    x, y, z = points.T
    dx, dy, dz = velocities.T
    moved = np.empty((len(points), 2))
    moved[:, 0] = camera.fx * (dx - x / z * dz) / z
    moved[:, 1] = camera.fy * (dy - y / z * dz) / z
    return moved


def edge_jacobian(edges: Edges, camera: Camera) -> Float64:
    """Derivative (C, 6) of the edges' positions across themselves, px, by a motion of the die."""
    x, y, z = edges.points.T
    along = np.empty_like(edges.points)
    along[:, 0] = edges.across[:, 0] * camera.fx / z
    along[:, 1] = edges.across[:, 1] * camera.fy / z
    along[:, 2] = -(along[:, 0] * x + along[:, 1] * y) / z
    return np.concatenate([along, cross(edges.arms, along)], axis=1)

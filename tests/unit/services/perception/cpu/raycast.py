"""An exact picture of a rounded die, by sphere tracing: the tracker's truth, made without its code or MuJoCo.

The distance to a rounded box is exact (Quilez, "Distance functions"); a pixel's colour averages several rays.
"""

from dataclasses import dataclass

import numpy as np

from common import geometry
from common.die import DIE, FACES, Die
from services.perception.frames import Frame

K = np.array([[615.0, 0.0, 320.0], [0.0, 615.0, 240.0], [0.0, 0.0, 1.0]])
SIZE = (480, 640)
_RAYS = 2  # a side of a pixel
_LIGHT = np.array([-0.4, -0.6, -0.69])  # towards the light, camera frame
_UNIT_M = 1e-4


@dataclass(frozen=True)
class Ball:
    """Something in front of the die, or beside it."""

    centre: tuple[float, float, float]
    radius: float
    rgb: tuple[int, int, int] = (190, 140, 110)


def transform(position, axis, angle_deg):
    """T_camera_die (4, 4)."""
    q = geometry.from_axis_angle(np.array(axis, np.float64), np.array(np.radians(angle_deg)))
    matrix = np.eye(4)
    matrix[:3, :3] = geometry.rotate(np.broadcast_to(q, (3, 4)), np.eye(3)).T
    matrix[:3, 3] = position
    return matrix


def photograph(
    truth, balls=(), *, die: Die = DIE, background_m=0.6, background=(70, 90, 60), number=0, t_ns=0, rng=None
) -> Frame:
    """A frame of the die at `truth` (4, 4) before a wall; `rng` adds noise of 2 levels and 0.5 mm."""
    colour = np.empty((*SIZE, 3))
    colour[:] = background
    depth = np.full(SIZE, background_m)
    for body in (None, *balls):
        _draw(body, truth, die, colour, depth)
    if rng is not None:
        colour = colour + rng.normal(0, 2.0, colour.shape)
        depth = depth + rng.normal(0, 0.0005, depth.shape)
    return Frame(
        colour=np.clip(np.rint(colour), 0, 255).astype(np.uint8),
        depth=np.rint(depth / _UNIT_M).astype(np.uint16),
        depth_unit_m=_UNIT_M,
        camera_matrix=K,
        colour_time_ns=t_ns,
        depth_time_ns=t_ns,
        frame_number=number,
    )


def _draw(ball, truth, die, colour, depth):
    """Paint one body over what is farther than it."""
    centre = truth[:3, 3] if ball is None else np.array(ball.centre)
    reach = die.size_m * 0.87 if ball is None else ball.radius
    u, v = (K @ centre)[:2] / centre[2]
    half = K[0, 0] * reach / (centre[2] - reach) + 3
    columns = np.arange(max(0, int(u - half)), min(SIZE[1], int(u + half) + 1))
    rows = np.arange(max(0, int(v - half)), min(SIZE[0], int(v + half) + 1))
    if not (len(rows) and len(columns)):
        return
    offsets = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
    total = np.zeros((len(rows), len(columns), 3))
    behind = depth[np.ix_(rows, columns)]
    for dv in offsets:
        for du in offsets:
            z, paint = _trace(ball, truth, die, columns + du, rows + dv)
            total += np.where((z < behind)[..., None], paint, colour[np.ix_(rows, columns)])
    colour[np.ix_(rows, columns)] = total / _RAYS**2
    depth[np.ix_(rows, columns)] = np.minimum(_trace(ball, truth, die, columns, rows)[0], behind)


def _trace(ball, truth, die, u, v):
    """Depth (R, C), m, inf where missed, and colour (R, C, 3) of one body along rays."""
    x, y = np.meshgrid((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1])
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    travelled = _to_die(truth, die, rays) if ball is None else _to_ball(ball, rays)
    points = travelled[..., None] * rays
    distance, normals = _distance(ball, truth, die, points)
    hit = np.abs(distance) < 1e-5
    shade = 0.35 + 0.65 * np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0, 1)
    paint = _paint(truth, die, points) if ball is None else np.broadcast_to(ball.rgb, points.shape)
    return np.where(hit, points[..., 2], np.inf), shade[..., None] * paint


def _to_die(truth, die, rays):
    """How far (R, C) m along unit rays the die is, by sphere tracing; 1 or more where they miss it."""
    flat = rays.reshape(-1, 3)
    travelled = np.full(len(flat), np.linalg.norm(truth[:3, 3]) - die.size_m)  # nothing of it is nearer
    going = np.arange(len(flat))
    while len(going):
        gap, _ = _distance(None, truth, die, travelled[going, None] * flat[going])
        travelled[going] += gap
        going = going[(gap > 1e-6) & (travelled[going] < 1.0)]
    return travelled.reshape(rays.shape[:-1])


def _to_ball(ball, rays):
    """How far (R, C) m along unit rays the ball is, 10 where they miss it."""
    along = rays @ np.array(ball.centre)
    inside = ball.radius**2 - np.sum(np.square(ball.centre)) + along**2
    return np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), 10.0)


def _distance(ball, truth, die, points):
    """Distance (R, C) m to a body, and its outward normals (R, C, 3)."""
    if ball is not None:
        away = points - np.array(ball.centre)
        length = np.linalg.norm(away, axis=-1)
        return length - ball.radius, away / length[..., None]
    local = (points - truth[:3, 3]) @ truth[:3, :3]
    core = die.half_m - die.corner_radius_m
    over = np.abs(local) - core
    outside = np.sign(local) * np.maximum(over, 0)
    length = np.linalg.norm(outside, axis=-1)
    distance = length + np.minimum(over.max(axis=-1), 0) - die.corner_radius_m
    return distance, outside / np.maximum(length, 1e-12)[..., None] @ truth[:3, :3].T


def _paint(truth, die, points):
    local = (points - truth[:3, 3]) @ truth[:3, :3]
    face = np.argmax(local @ die.normals.T, axis=-1)
    pip = np.zeros(face.shape, bool)
    for number in range(FACES):
        right, up, _ = die.frames[number]
        for centre in die.pip_offsets(number + 1):
            near = (local @ right - centre[0]) ** 2 + (local @ up - centre[1]) ** 2 < die.pip_radius_m**2
            pip |= near & (face == number)
    return np.where(pip[..., None], die.pip_rgb, die.body_rgb)

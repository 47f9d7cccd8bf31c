"""Unit quaternions (w, x, y, z) for numpy and torch from one definition, by array-API names.

Every function takes arrays with any batch shape (..., 4) or (..., 3), broadcasts, keeps the input's library,
dtype and device, and is differentiable in torch. A quaternion rotates vectors of the body frame into the
parent frame; q and -q are the same rotation.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array", NDArray[Any], "torch.Tensor")

# Below this norm a quaternion has no direction worth trusting: it comes from a diverged prediction.
MIN_NORM = 1e-3
# Below this length sin(x)/x is 1 in double precision, and dividing by x would only add noise.
_SMALL_ANGLE = 1e-8


def namespace(x: Array) -> Any:
    """The library whose functions act on `x`: torch for tensors, else numpy."""
    # Looked up, not imported: processes that never see a tensor start 3 s sooner and 150 MB lighter.
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(x, torch.Tensor) else np


def normalise(q: Array) -> Array:
    """Scale (..., 4) to norm 1; what is shorter than MIN_NORM stays short, never NaN, and can be rejected."""
    xp = namespace(q)
    return q / xp.clip(xp.linalg.vector_norm(q, axis=-1, keepdims=True), MIN_NORM, None)


def multiply(p: Array, q: Array) -> Array:
    """Hamilton product (..., 4): rotate by `q`, then by `p`."""
    xp = namespace(p)
    pw, px, py, pz = (p[..., i] for i in range(4))
    qw, qx, qy, qz = (q[..., i] for i in range(4))
    return xp.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """The inverse (..., 4) of unit quaternions."""
    return namespace(q).concat([q[..., :1], -q[..., 1:]], axis=-1)


def rotate(q: Array, v: Array) -> Array:
    """Vectors `v` (..., 3), given in the body frame of unit `q` (..., 4), in the parent frame."""
    cross = namespace(q).linalg.cross
    w, u = q[..., :1], q[..., 1:]
    xp = namespace(q)
    u, v = (u, v) if xp is np else xp.broadcast_tensors(u, v)
    return v + 2 * cross(u, cross(u, v) + w * v)


def angle(p: Array, q: Array) -> Array:
    """Geodesic angle (...), rad in [0, π], between unit quaternions: 2·arccos|⟨p, q⟩|.

    Kahan's form 4·atan2(‖p - q‖, ‖p + q‖) is exact near 0, where arccos loses half of the digits, and its
    gradient is finite everywhere (0 at equal rotations), where that of arccos is not.
    """
    xp = namespace(p)
    nearer = xp.where(xp.sum(p * q, axis=-1, keepdims=True) < 0, -q, q)
    norm = xp.linalg.vector_norm
    return 4 * xp.atan2(norm(p - nearer, axis=-1), norm(p + nearer, axis=-1))


def turn(p: Array, q: Array) -> Array:
    """Rotation vector (..., 3), rad, of the shortest turn from `p` to `q` (..., 4); its length is `angle`.

    In the frame of `p`; smooth at equal rotations, unlike the angle; jumps at half a circle.
    """
    return to_rotation_vector(multiply(conjugate(p), q))


def signed_angle(p: Array, q: Array) -> Array:
    """Angle (...), rad in [0, 2π], as the Shadow Hand environments compute it: 2·arccos(w) of p·q⁻¹.

    It tells q from -q, so it may ask for the long way round. Its gradient is infinite where p = ±q: use it
    to report, not to plan. Source: gymnasium_robotics/envs/shadow_dexterous_hand/manipulate.py.
    """
    xp = namespace(p)
    return 2 * xp.acos(xp.clip(multiply(p, conjugate(q))[..., 0], -1.0, 1.0))


def from_axis_angle(axis: Array, angle_rad: Array) -> Array:
    """Unit quaternions (..., 4) of a turn by `angle_rad` (...) about `axis` (..., 3), of any length but 0."""
    xp = namespace(axis)
    half = angle_rad[..., None] / 2
    unit = axis / xp.linalg.vector_norm(axis, axis=-1, keepdims=True)
    w, u = xp.cos(half), xp.sin(half) * unit
    w = xp.broadcast_to(w, (*u.shape[:-1], 1))
    return xp.concat([w, u], axis=-1)


def to_rotation_vector(q: Array) -> Array:
    """Axis times angle (..., 3), rad, of unit quaternions the short way round: length in [0, π]."""
    xp = namespace(q)
    q = xp.where(q[..., :1] < 0, -q, q)
    w, u = q[..., :1], q[..., 1:]
    length = xp.linalg.vector_norm(u, axis=-1, keepdims=True)
    divisor = xp.clip(length, _SMALL_ANGLE, None)
    return u * xp.where(length < _SMALL_ANGLE, 2.0, 2 * xp.atan2(divisor, w) / divisor)


def from_rotation_vector(vector: Array) -> Array:
    """Unit quaternions (..., 4) of turns by ‖vector‖ (..., 3), rad, about it; differentiable at 0, too."""
    xp = namespace(vector)
    half = vector / 2
    squared = xp.sum(half * half, axis=-1, keepdims=True) + _SMALL_ANGLE**2
    half_angle_rad = xp.sqrt(squared)
    return xp.concat([xp.cos(half_angle_rad), half * (xp.sin(half_angle_rad) / half_angle_rad)], axis=-1)

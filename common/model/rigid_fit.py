"""How a body moves that several points carry along: the weighted rigid motion nearest to theirs.

Letters: C points, N states. Vectors are (3, C, N) or (3, N), so that every operation runs over the states.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Motion(NamedTuple):
    """A small rigid motion: shift of the body's centre (3, N), m, and turn (3, N), rad."""

    shift: Tensor
    turn: Tensor


def carried(
    weight: Tensor, arm: Tensor, moved: Tensor, drift: Motion, inertia: tuple[float, float]
) -> Motion:
    """The motion that points at `arm` (3, C, N) from the centre, moving by `moved`, impart to a body.

    It minimises Σ_c w_c ‖moved_c - shift - turn × arm_c‖² + m ‖shift - drift.shift‖²
    + j ‖turn - drift.turn‖², with w (C, N) and (m, j) = `inertia`: points stick to the body as firmly as
    they weigh, and what nothing touches drifts on.
    """
    mass, spin = inertia
    total = weight.sum(0) + mass
    middle = (weight * arm).sum(1) / total
    shift = ((weight * moved).sum(1) + mass * drift.shift) / total
    # The body's own drift counts as a point at the centre, which is `-middle` from their common middle.
    arms = torch.cat((arm, torch.zeros_like(middle)[:, None]), dim=1) - middle[:, None]
    moves = torch.cat((moved, drift.shift[:, None]), dim=1) - shift[:, None]
    weights = torch.cat((weight, torch.full_like(total, mass)[None]))
    torque = (weights * cross(arms, moves)).sum(1) + spin * drift.turn
    turn = _solved(_inertia(weights, arms, spin), torque)
    return Motion(shift - cross(turn, middle), turn)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Vector products of (3, ...), written out: wide operations where `torch.linalg.cross` strides."""
    (ax, ay, az), (bx, by, bz) = a.unbind(), b.unbind()
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def _inertia(weights: Tensor, arms: Tensor, spin: float) -> Tensor:
    """Σ w (‖r‖² - r rᵀ) + spin, (3, 3, N): symmetric and positive."""
    weighed = weights * arms
    outer = (weighed[:, None] * arms[None]).sum(2)
    eye = torch.eye(3, dtype=arms.dtype, device=arms.device)[..., None]
    return (outer.diagonal(dim1=0, dim2=1).sum(-1) + spin) * eye - outer


def _solved(matrix: Tensor, right: Tensor) -> Tensor:
    """x (3, N) of matrix·x = right, for symmetric (3, 3, N), by Cramer's rule."""
    a, b, c = matrix.unbind()
    rows = torch.stack((cross(b, c), cross(c, a), cross(a, b)))
    return (rows * right).sum(1) / (a * rows[0]).sum(0)

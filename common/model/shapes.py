"""Shapes of objects, as far as a hand feels them: gaps, normals, and orientation up to physical symmetry.

Letters: C points, N states. Points are in the object's own frame, m; all functions are differentiable.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Protocol

import torch
from torch import Tensor

# Lengths whose square root is differentiated stay above it, m: a gradient at 0 would be infinite.
_TINY = 1e-6
_BISECTIONS = 4  # to 1/32 of a rod, 1.4 mm


class Shape(Protocol):
    """A convex body, centred at its frame's origin."""

    def gap(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Distance (C, N), m, of points (3, C, N) from the surface (negative inside), normals (3, C, N)."""
        ...

    def nearest(self, start: Tensor, rod: Tensor) -> Tensor:
        """Where between `start` (0) and `start + rod` (1), (3, C, N) each, the gap is smallest: (C, N)."""
        ...

    def extent(self, directions: Tensor) -> Tensor:
        """How far the body reaches (N,), m, along unit directions (3, N)."""
        ...

    def orientation(self, rotation: Tensor) -> Tensor:
        """Numbers (k, N) that two rotations (3, 3, N) share if and only if the body looks alike in both."""
        ...


@dataclass(frozen=True)
class Ellipsoid:
    """A spheroid about its own z: half sizes a, a, c."""

    half_sizes: tuple[float, float, float]

    def gap(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """To first order in the distance from the surface, where it is exact (Quilez, sdEllipsoid)."""
        sizes = _column(self.half_sizes, points)
        scaled, gradient = points / sizes, points / sizes.square()
        inside, slope = _length(scaled), _length(gradient)
        return inside * (inside - 1) / slope, gradient / slope

    def nearest(self, start: Tensor, rod: Tensor) -> Tensor:
        """Where the rod is nearest in the space in which the body is a sphere: the gap is 0.1 mm off."""
        sizes = _column(self.half_sizes, start)
        near, along = start / sizes, rod / sizes
        return (-(near * along).sum(0) / along.square().sum(0)).clamp(0.0, 1.0)

    def extent(self, directions: Tensor) -> Tensor:
        """‖diag(half sizes)·direction‖."""
        return _length(directions * _column(self.half_sizes, directions))

    def orientation(self, rotation: Tensor) -> Tensor:
        """The long axis times itself: blind to its sign and to turns about it; k = 6."""
        axis = rotation[:, 2]
        return torch.stack([axis[i] * axis[j] for i, j in combinations_with_replacement(range(3), 2)])


@dataclass(frozen=True)
class Cube:
    """A cube of half size `half`."""

    half: float

    def gap(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Exact; the normal at an edge or corner points from it to the point."""
        beyond = points.abs() - self.half
        outside = beyond.clamp(min=0.0)
        distance = _length(outside)
        deepest = beyond.amax(0)
        face = (beyond == deepest) * points.sign()
        normal = torch.where(deepest > 0, points.sign() * outside / distance, face)
        return torch.where(deepest > 0, distance, deepest), normal

    @torch.no_grad()
    def nearest(self, start: Tensor, rod: Tensor) -> Tensor:
        """By bisection, for the gap is convex along the rod.

        A constant to gradients, which is exact for the gap: at its smallest it does not change along the rod.
        """
        share, step = torch.full_like(start[0], 0.5), 0.25
        for _ in range(_BISECTIONS):
            _, normal = self.gap(start + share * rod)
            share = share - step * (normal * rod).sum(0).sign()
            step /= 2
        ends = torch.where(share < 2 * step, 0.0, share)
        return torch.where(ends > 1 - 2 * step, 1.0, ends)

    def extent(self, directions: Tensor) -> Tensor:
        """Half size times the sum of the direction's absolute components."""
        return self.half * directions.abs().sum(0)

    def orientation(self, rotation: Tensor) -> Tensor:
        """Sum over axes of axis ⊗ axis ⊗ axis ⊗ axis: the same for a cube's 24 rotations; k = 15."""
        terms = [
            (rotation[i] * rotation[j] * rotation[k] * rotation[m]).sum(0)
            for i, j, k, m in combinations_with_replacement(range(3), 4)
        ]
        return torch.stack(terms)


def _column(sizes: tuple[float, ...], like: Tensor) -> Tensor:
    return like.new_tensor(sizes).view(3, *[1] * (like.dim() - 1))


def _length(vectors: Tensor) -> Tensor:
    return (vectors.square().sum(0) + _TINY**2).sqrt()

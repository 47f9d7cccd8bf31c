"""Gauss-Newton against optima that are known: by hand, by optimality conditions, by enumeration."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from services.planner.gauss_newton import gauss_newton

SHAPE = (2, 3)
ZERO = torch.zeros(SHAPE)


def linear(rows: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """A well-conditioned map (6, rows) of the flattened sequence, and a target (rows,)."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(6, rows, generator=generator), 2 * torch.randn(rows, generator=generator)


def refined(residuals, steps: int = 3, start: Tensor = ZERO, difference: float = 0.02):
    """Refine with the score -Σ‖r‖ of `residuals`: (N, K, A) → a list of (N, R)."""

    def score(points: Tensor) -> Tensor:
        return -sum(torch.linalg.vector_norm(part, dim=-1) for part in residuals(points))

    return gauss_newton(score, lambda points: (score(points), residuals(points)), start, steps, difference)


def test_a_linear_residual_is_solved_to_its_bounded_least_squares():
    matrix, target = linear(8)
    found = refined(lambda points: [points.flatten(1) @ matrix - target], steps=60)
    x = found.best.flatten()
    gradient = matrix @ (x @ matrix - target)
    bound = x.abs() == 1.0
    assert 0 < bound.sum() < len(x), "some bounds must matter in this problem, not all"
    assert (gradient * x)[bound].max() < 0.0  # pushes outwards
    assert gradient[~bound].abs().max() < 0.01 * gradient[bound].abs().max()


def test_one_step_reaches_what_lies_within_the_bounds():
    matrix, _ = linear(8)
    optimum = torch.linspace(-0.5, 0.5, 6)
    found = refined(lambda points: [(points.flatten(1) - optimum) @ matrix], steps=1)
    assert (found.best.flatten() - optimum).abs().max() < 0.01  # the least damping leaves 1e-3 of the way


def test_the_sum_of_norms_has_its_minimum_at_the_geometric_median():
    corners = torch.tensor([[0.0, 0.0], [0.8, 0.0], [0.1, 0.6]])

    def residuals(points: Tensor) -> list[Tensor]:
        return [points.flatten(1) - corner for corner in corners]

    found = refined(residuals, steps=40, start=torch.tensor([[-0.9, -0.9]]))
    grid = torch.cartesian_prod(torch.linspace(0, 0.8, 401), torch.linspace(0, 0.6, 301))
    distances = (grid[:, None] - corners).norm(dim=-1).sum(1)
    assert float(found.scores[0]) == pytest.approx(-float(distances.min()), abs=2e-3)


def test_it_is_never_worse_than_its_start():
    # On the floor of a sharp valley the slope that differences show leads up the other wall.
    start = torch.full(SHAPE, 0.3)

    def residuals(points: Tensor) -> list[Tensor]:
        return [1.0 + 10.0 * (points - start).abs().flatten(1).sum(1, keepdim=True)]

    found = refined(residuals, start=start)
    assert torch.equal(found.best, start)
    assert float(found.scores[0]) == -1.0


def test_it_ends_at_once_where_nothing_is_better():
    seen: list[int] = []

    def residuals(points: Tensor) -> list[Tensor]:
        seen.append(len(points))
        return [points.flatten(1) + 0.0]

    assert torch.equal(refined(residuals, steps=5).best, ZERO)
    assert sum(seen) == 2 * 7 + 8  # score and residuals of the point and its neighbours, score of the trials


def test_a_start_without_a_finite_score_says_so():
    found = refined(lambda points: [points.flatten(1) * math.nan], start=ZERO)
    assert not found.valid
    assert torch.equal(found.best, ZERO)


def test_a_start_that_diverges_gives_way_to_a_neighbour_that_does_not():
    def residuals(points: Tensor) -> list[Tensor]:
        flat = points.flatten(1)
        return [torch.where(flat[:, :1] <= 0.0, math.nan, flat - 0.5)]

    found = refined(residuals, steps=4)
    assert found.valid
    assert float(found.best.flatten()[0]) == pytest.approx(0.02)  # the neighbour, whose own diverges again
    assert (found.best.flatten()[1:] - 0.5).abs().max() < 0.01


@pytest.mark.parametrize("residue", [math.nan, 1e25])
def test_a_coordinate_whose_neighbour_diverges_is_left_alone(residue):
    optimum = torch.linspace(0.2, 0.7, 6)

    def residuals(points: Tensor) -> list[Tensor]:
        flat = points.flatten(1)
        return [torch.where(flat[:, :1].abs() > 0.0, residue, flat - optimum)]

    def score(points: Tensor) -> Tensor:
        (residual,) = residuals(points)
        norm = residual.norm(dim=-1)
        return torch.where(norm < 1e3, -norm, -math.inf)

    found = gauss_newton(score, lambda points: (score(points), residuals(points)), ZERO, 2, 0.02)
    assert float(found.best.flatten()[0]) == 0.0
    assert (found.best.flatten()[1:] - optimum[1:]).abs().max() < 0.01


@pytest.mark.parametrize("edge", [-1.0, 1.0])
def test_differences_are_taken_inwards_at_a_bound(edge):
    seen: list[Tensor] = []

    def residuals(points: Tensor) -> list[Tensor]:
        seen.append(points)
        return [points.flatten(1)]

    found = refined(residuals, start=torch.full(SHAPE, edge), steps=1, difference=0.1)
    assert all(points.abs().max() <= 1.0 for points in seen)
    assert found.best.abs().max() < 0.01

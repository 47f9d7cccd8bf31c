"""Refinement of one sequence by Gauss-Newton steps on the distances that make up the reward.

A reward of the form -Σ‖r_j‖ is no sum of squares, but around a point each norm lies below the parabola
‖r‖²/(2·‖r₀‖) + ‖r₀‖/2, which touches it there: minimising the parabolas improves the norms (iteratively
reweighted least squares). The weight 1/‖r₀‖ is softened to 1/(‖r₀‖ + ε), so that a term that is all but met
does not freeze the rest; which step is taken is decided by the true score. The Jacobian comes from
differences of roll-outs, K·A + 1 candidates in one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from services.planner.cem import HIGH, LOW, Found, Score, nothing, usable

# Maps sequences (N, K, A) to scores (N,) and to the reward's residuals, each (..., N, R).
ScoreAndResiduals = Callable[[Tensor], tuple[Tensor, Sequence[Tensor]]]

# ε, in the reward's unit: a term as small as this pulls half as hard. On reach 0.5 to 10 mm do the same. What
# is weighted far below it, as Eq. (5)'s smoothing may be, counts by the score alone.
_NEAR = 0.002
# Levenberg-Marquardt: shares of the mean curvature that are added to every curvature.
_DAMPINGS = (1e-3, 1e-2, 1e-1, 1.0)
_STEP_LENGTHS = (1.0, 0.5)
_BOUND_ROUNDS = 3


def gauss_newton(
    score: Score, score_and_residuals: ScoreAndResiduals, start: Tensor, steps: int, difference: float
) -> Found:
    """Improve `start` (K, A) by up to `steps` (at least 1) steps within [-1, 1]; the answer is never worse.

    Each step: residuals at the point and `difference` beside it in each coordinate, the damped least-squares
    step for several dampings and lengths, and the best by score of all these. It ends when the point itself
    is the best. A start without a finite score gives way to its best neighbour; without any it says so.
    """
    point, best = start, start.new_full((), -torch.inf)
    for _ in range(steps):
        beside, signed = _beside(point, difference)
        scores, residuals = score_and_residuals(beside)
        tried, values = beside, usable(scores)
        if torch.isfinite(scores[0]):
            trials = _trials(point, *_normal_equations(residuals, signed, torch.isfinite(scores[1:])))
            tried, values = torch.cat((beside, trials)), torch.cat((values, usable(score(trials))))
        best, index = values.max(0)
        point = tried[index]
        if index == 0:
            break
    return Found(point, point[None], best[None], valid=True) if torch.isfinite(best) else nothing(start)


def _beside(point: Tensor, difference: float) -> tuple[Tensor, Tensor]:
    """The point and its neighbours (n + 1, K, A), and the signed distances (n,), inwards of the bounds."""
    signed = torch.where(point > 0, point.new_tensor(-difference), difference).flatten()
    return torch.cat((point[None], point + torch.diag(signed).view(-1, *point.shape))), signed


def _normal_equations(residuals: Sequence[Tensor], signed: Tensor, sound: Tensor) -> tuple[Tensor, Tensor]:
    """Curvature (n, n) and gradient (n,) of the parabolas around residuals (..., n + 1, R).

    A neighbour that is not `sound` (n,) has diverged and says nothing about its coordinate.
    """
    n = len(signed)
    curvature, gradient = signed.new_zeros(n, n), signed.new_zeros(n)
    for residual in residuals:
        here = residual[..., :1, :]
        jacobian = (residual[..., 1:, :] - here) / signed[:, None]
        weight = 1.0 / (torch.linalg.vector_norm(here, dim=-1, keepdim=True) + _NEAR)
        rows = (jacobian * weight.sqrt()).movedim(-2, 0).reshape(n, -1)
        rows = torch.where(sound[:, None], rows, 0.0)
        curvature += rows @ rows.T
        gradient += rows @ (here * weight.sqrt()).flatten()
    return curvature, gradient


def _trials(point: Tensor, curvature: Tensor, gradient: Tensor) -> Tensor:
    """Where the damped steps lead, at each length: (D·L, K, A)."""
    ends = _bounded_steps(point.flatten(), curvature, gradient).view(-1, *point.shape)
    return torch.cat([point + length * (ends - point) for length in _STEP_LENGTHS])


def _bounded_steps(point: Tensor, curvature: Tensor, gradient: Tensor) -> Tensor:
    """Points (D, n) near the minima of the damped parabola within the bounds, one for each damping.

    A coordinate that would leave the bounds is held there for good, and the others are solved anew.
    """
    damping = torch.tensor(_DAMPINGS, dtype=point.dtype, device=point.device)[:, None, None]
    eye = torch.eye(len(point), dtype=point.dtype, device=point.device)
    mean = curvature.diagonal().mean().clamp(min=1e-12)
    damped = curvature + damping * mean * eye
    held = torch.zeros(len(damped), len(point), dtype=torch.bool, device=point.device)
    step = torch.zeros_like(point).expand(len(damped), -1)
    for _ in range(_BOUND_ROUNDS):
        step = _solve(damped, gradient, held, step)
        wanted = point + step
        outside = (wanted < LOW) | (wanted > HIGH)
        step = wanted.clamp(LOW, HIGH) - point
        held = held | outside
    return point + step


def _solve(matrix: Tensor, gradient: Tensor, held: Tensor, step: Tensor) -> Tensor:
    """Solve matrix·x = -gradient with the `held` coordinates (D, n) fixed at `step`: (D, n)."""
    fixed = torch.where(held, step, 0.0)
    right = torch.where(held, step, -gradient - (matrix @ fixed[..., None])[..., 0])
    apart = held[:, :, None] | held[:, None, :]
    eye = torch.eye(held.shape[1], dtype=matrix.dtype, device=matrix.device)
    return torch.linalg.solve(torch.where(apart, eye, matrix), right)

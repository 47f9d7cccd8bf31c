"""Refinement of a few sequences by Adam through a differentiable score."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from services.planner.cem import HIGH, LOW, Found, Score, nothing, top, usable

# Maps sequences (N, K, A) to scores (N,) and to their gradients (N, K, A).
ScoreAndGradient = Callable[[Tensor], tuple[Tensor, Tensor]]

_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-8


def refine(
    score: Score, score_and_gradient: ScoreAndGradient, start: Tensor, steps: int, rate: float
) -> Found:
    """Climb from each sequence of `start` (N, K, A) with `steps` Adam steps, within [-1, 1].

    The step size falls linearly from `rate` to nearly zero, or the last steps would jump about the optimum.
    Of each sequence the best point seen is kept, so no refinement is worse than its start; a sequence whose
    score or gradient is not finite takes no step. Returns all usable ones, best first.
    """
    point, best = start, start
    best_score = torch.full_like(start[:, 0, 0], -torch.inf)
    first, second = torch.zeros_like(start), torch.zeros_like(start)
    for step in range(1, steps + 1):
        value, gradient = score_and_gradient(point)
        best, best_score = _keep_best(best, best_score, point, value)
        sound = torch.isfinite(gradient).flatten(1).all(1) & torch.isfinite(value)
        gradient = torch.where(sound[:, None, None], gradient, 0.0)
        first = torch.where(sound[:, None, None], first.lerp(gradient, 1 - _BETA1), first)
        second = torch.where(sound[:, None, None], second.lerp(gradient.square(), 1 - _BETA2), second)
        falling = rate * (steps - step + 1) / steps
        point = _adam_step(point, first, second, step, falling * sound[:, None, None])
    best, best_score = _keep_best(best, best_score, point, score(point))
    elites, scores = top(best, best_score, len(best))
    return Found(elites[0], elites, scores, valid=True) if len(elites) else nothing(start[0])


def _adam_step(point: Tensor, first: Tensor, second: Tensor, step: int, rate: Tensor) -> Tensor:
    mean = first / (1 - _BETA1**step)
    deviation = (second / (1 - _BETA2**step)).sqrt()
    return (point + rate * mean / (deviation + _EPSILON)).clamp(LOW, HIGH)


def _keep_best(best: Tensor, best_score: Tensor, point: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    value = usable(value)
    better = value > best_score
    return torch.where(better[:, None, None], point, best), torch.where(better, value, best_score)

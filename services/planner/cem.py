"""Cross-entropy method as DPETS codes it: truncated Gaussian, damped refit, the mean is the answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from services.planner.config import PlannerConfig

# Maps candidates (N, K, A) to scores (N,), higher is better; non-finite means unusable.
Score = Callable[[Tensor], Tensor]

LOW, HIGH = -1.0, 1.0  # the bounds of a normalised action
_TRUNCATION = 2.0  # in standard deviations


@dataclass(frozen=True)
class Found:
    """Outcome of a search: `best` (K, A), and the elites (E, K, A), best first, with scores (E,).

    `valid` is False, and `best` the warm start, if no candidate had a finite score.
    """

    best: Tensor
    elites: Tensor
    scores: Tensor
    valid: bool


def cem(score: Score, warm_start: Tensor, config: PlannerConfig, generator: torch.Generator) -> Found:
    """Maximise `score` around `warm_start` (K, A) within [-1, 1]; returns the mean of the last elites.

    Each iteration: a ~ N(μ, v) truncated at ±2σ, v limited so that μ ± 2σ stays within the bounds;
    μ ← α μ + (1-α) mean(elites), v likewise; stops when max v < `min_variance`.
    """
    mean, variance = warm_start, torch.full_like(warm_start, config.init_std**2)
    found = nothing(warm_start)
    for _ in range(config.iterations):
        if float(variance.max()) < config.min_variance:
            break
        candidates = _truncated(mean, variance, config.candidates, generator)
        elites, scores = top(candidates, score(candidates), config.elites)
        if len(elites) == 0:
            break
        mean, variance = refit(mean, variance, elites, config.momentum)
        found = Found(mean, elites, scores, valid=True)
    return found


def nothing(warm_start: Tensor) -> Found:
    """The outcome of a search that found no usable candidate."""
    none = warm_start.new_empty(0, *warm_start.shape)
    return Found(warm_start, none, none.new_empty(0), valid=False)


def top(candidates: Tensor, scores: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The best `count` of candidates (N, K, A) and their scores, best first; none with a non-finite score."""
    finite = usable(scores)
    count = min(count, int(torch.isfinite(scores).sum()))
    values, index = finite.topk(count)
    return candidates[index], values


def usable(scores: Tensor) -> Tensor:
    """Scores (N,) with every non-finite one replaced by -inf, so that none can win a comparison."""
    return torch.where(torch.isfinite(scores), scores, -math.inf)


def refit(mean: Tensor, variance: Tensor, elites: Tensor, momentum: float) -> tuple[Tensor, Tensor]:
    """Damped mean and variance (K, A) of elites (E, K, A): α old + (1-α) new."""
    new_mean, new_variance = elites.mean(0), elites.var(0, correction=0)
    return new_mean.lerp(mean, momentum), new_variance.lerp(variance, momentum)


def _truncated(mean: Tensor, variance: Tensor, N: int, generator: torch.Generator) -> Tensor:
    """Truncated normal samples (N, K, A), by inverting the distribution function."""
    room = torch.minimum(mean - LOW, HIGH - mean) / _TRUNCATION
    std = torch.minimum(room.square(), variance).sqrt()
    tail = 0.5 * math.erfc(_TRUNCATION / math.sqrt(2.0))
    uniform = torch.rand((N, *mean.shape), generator=generator, device=generator.device).to(mean)
    standard = math.sqrt(2.0) * torch.erfinv((2 * tail - 1) + (2 - 4 * tail) * uniform)
    return mean + std * standard

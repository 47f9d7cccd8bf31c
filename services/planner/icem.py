"""iCEM (Pinneri et al., 2020): coloured noise, shrinking population, elites kept within and between plans."""

from __future__ import annotations

import torch
from torch import Tensor

from services.planner.cem import HIGH, LOW, Found, Score, nothing, refit, top
from services.planner.config import PlannerConfig


def icem(
    score: Score, warm_start: Tensor, kept: Tensor, config: PlannerConfig, generator: torch.Generator
) -> Found:
    """Maximise `score` around `warm_start` (K, A) within [-1, 1]; returns the best candidate seen.

    `kept` (E, K, A), possibly empty, are the last plan's best, already shifted to this plan's start.
    """
    mean, variance = warm_start, torch.full_like(warm_start, config.init_std**2)
    found = nothing(warm_start)
    kept = kept[: _share(config, len(kept))]
    for iteration in range(config.iterations):
        candidates = [kept, _samples(mean, variance, _population(config, iteration), config, generator)]
        if iteration == config.iterations - 1:
            candidates.append(mean[None])
        batch = torch.cat(candidates)
        elites, scores = top(batch, score(batch), config.elites)
        if len(elites) == 0:
            break
        mean, variance = refit(mean, variance, elites, config.momentum)
        kept = elites[: _share(config, len(elites))]
        found = _better(found, Found(elites[0], elites, scores, valid=True))
    return found


def coloured(shape: tuple[int, ...], beta: float, generator: torch.Generator) -> Tensor:
    """Gaussian noise of unit variance along the last axis of `shape`, its power falling as f^-β.

    Source: Timmer and König (1995), as in the `colorednoise` package. The zero frequency takes the power of
    the lowest other one, so that a whole sequence can lean to one side.
    """
    length = shape[-1]
    white = torch.randn(shape, generator=generator, device=generator.device)
    if length == 1 or beta == 0.0:
        return white
    frequency = torch.fft.rfftfreq(length, device=white.device).clamp(min=1.0 / length)
    amplitude = frequency ** (-beta / 2)
    filtered = torch.fft.irfft(torch.fft.rfft(white) * amplitude, n=length)
    # Every frequency but zero and the Nyquist one stands for itself and for its negative.
    doubled = torch.full_like(amplitude, 2.0)
    doubled[0] = 1.0
    if length % 2 == 0:
        doubled[-1] = 1.0
    return filtered / ((doubled * amplitude.square()).sum() / length).sqrt()


def _samples(
    mean: Tensor, variance: Tensor, N: int, config: PlannerConfig, generator: torch.Generator
) -> Tensor:
    K, A = mean.shape
    noise = coloured((N, A, K), config.noise_beta, generator).transpose(1, 2).to(mean)
    return (mean + variance.sqrt() * noise).clamp(LOW, HIGH)


def _population(config: PlannerConfig, iteration: int) -> int:
    """Candidates drawn: N·decay^-i, at least twice the elites, at most N."""
    shrunk = int(config.candidates * config.population_decay**-iteration)
    return min(config.candidates, max(shrunk, 2 * config.elites))


def _share(config: PlannerConfig, available: int) -> int:
    return min(available, round(config.keep_fraction * config.elites))


def _better(old: Found, new: Found) -> Found:
    """The newer elites, led by the best candidate ever seen."""
    if not old.valid or old.scores[0] <= new.scores[0]:
        return new
    elites, scores = torch.cat((old.best[None], new.elites)), torch.cat((old.scores[:1], new.scores))
    return Found(old.best, elites[:-1], scores[:-1], valid=True)

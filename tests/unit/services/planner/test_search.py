"""CEM, iCEM and gradient refinement on functions whose maximum is known."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from services.planner.cem import cem, top
from services.planner.config import PlannerConfig
from services.planner.gradient import refine
from services.planner.icem import coloured, icem
from tests.unit.services.planner.models import seeded

SHAPE = (4, 3)
INSIDE = torch.linspace(-0.6, 0.7, 12).reshape(SHAPE)
OUTSIDE = torch.linspace(-1.5, 1.5, 12).reshape(SHAPE)


def quadratic(optimum: Tensor):
    return lambda actions: -(actions - optimum).square().sum((1, 2))


def search(name: str, score, seed: int = 0, **overrides):
    if name == "cem":
        config = PlannerConfig(iterations=30, min_variance=1e-6, **overrides)
        return cem(score, torch.zeros(SHAPE), config, seeded(seed))
    settings = {
        "candidates": 300,
        "elites": 20,
        "iterations": 20,
        "noise_beta": 0.5,
        "population_decay": 1.0,
    } | overrides
    config = PlannerConfig(preset="fast", **settings)
    return icem(score, torch.zeros(SHAPE), torch.empty(0, *SHAPE), config, seeded(seed))


@pytest.mark.parametrize("name", ["cem", "icem"])
@pytest.mark.parametrize("optimum", [INSIDE, OUTSIDE], ids=["inside", "on the bounds"])
def test_finds_the_optimum_of_a_quadratic(name, optimum):
    # CEM's variance shrinks as its mean nears a bound, so that it comes to rest a little early there.
    tolerance = 0.2 if optimum is OUTSIDE else 0.06
    found = search(name, quadratic(optimum))
    assert found.valid
    assert (found.best - optimum.clamp(-1, 1)).abs().max() < tolerance
    assert found.best.abs().max() <= 1.0


@pytest.mark.parametrize("name", ["cem", "icem"])
@pytest.mark.parametrize("poison", [math.nan, math.inf, -math.inf])
def test_a_candidate_without_a_finite_score_is_never_elite(name, poison):
    def score(actions: Tensor) -> Tensor:
        return torch.where(actions[:, 0, 0] > -0.2, poison, quadratic(OUTSIDE.abs())(actions))

    found = search(name, score)
    assert found.valid
    assert torch.isfinite(found.scores).all()
    assert (found.elites[:, 0, 0] <= -0.2).all()


@pytest.mark.parametrize("name", ["cem", "icem"])
def test_fewer_finite_candidates_than_elites(name):
    calls = []

    def score(actions: Tensor) -> Tensor:
        calls.append(len(actions))
        scores = torch.full((len(actions),), math.nan)
        scores[:3] = quadratic(INSIDE)(actions[:3])
        return scores

    found = search(name, score, iterations=3) if name == "icem" else search(name, score)
    assert found.valid
    assert len(found.elites) == 3


@pytest.mark.parametrize("name", ["cem", "icem"])
def test_without_any_finite_candidate_the_warm_start_comes_back_and_says_so(name):
    found = search(name, lambda actions: torch.full((len(actions),), math.nan))
    assert not found.valid
    assert torch.equal(found.best, torch.zeros(SHAPE))
    assert len(found.elites) == 0


@pytest.mark.parametrize("name", ["cem", "icem"])
def test_same_seed_same_answer(name):
    first, again, other = (search(name, quadratic(INSIDE), seed) for seed in (3, 3, 4))
    assert torch.equal(first.best, again.best)
    assert not torch.equal(first.best, other.best)


def test_top_orders_and_leaves_out():
    candidates = torch.arange(5.0).reshape(5, 1, 1)
    elites, scores = top(candidates, torch.tensor([1.0, math.nan, 3.0, math.inf, 2.0]), 4)
    assert elites.flatten().tolist() == [2.0, 4.0, 0.0]
    assert scores.tolist() == [3.0, 2.0, 1.0]


def test_cem_samples_stay_within_two_deviations_and_bounds():
    seen = []

    def score(actions: Tensor) -> Tensor:
        seen.append(actions)
        return quadratic(OUTSIDE)(actions)

    search("cem", score)
    assert seen[0].abs().max() <= 1.0  # ± 2 x 0.5 around zero
    assert all(batch.abs().max() <= 1.0 for batch in seen)
    assert abs(float(seen[0].std()) - 0.44) < 0.01  # of a Gaussian of 0.5 cut at ± 2σ


def test_cem_stops_once_the_variance_is_small():
    calls = []

    def score(actions: Tensor) -> Tensor:
        calls.append(1)
        return quadratic(INSIDE)(actions)

    cem(score, INSIDE, PlannerConfig(iterations=50, min_variance=0.01), seeded())
    assert len(calls) < 10


def test_icem_keeps_the_elites_it_is_given():
    config = PlannerConfig(preset="fast", candidates=16, elites=4, iterations=1, keep_fraction=0.5)
    found = icem(quadratic(INSIDE), torch.zeros(SHAPE), INSIDE[None], config, seeded())
    assert torch.equal(found.best, INSIDE)


def test_icem_tries_the_mean_last():
    config = PlannerConfig(preset="fast", candidates=16, elites=4, iterations=1)
    found = icem(quadratic(INSIDE), INSIDE, torch.empty(0, *SHAPE), config, seeded())
    assert torch.equal(found.best, INSIDE)


@pytest.mark.parametrize("beta", [0.0, 1.0, 2.0, 3.0])
def test_noise_has_the_asked_colour_and_unit_variance(beta):
    length = 64
    noise = coloured((20000, length), beta, seeded())
    assert abs(float(noise.var()) - 1.0) < 0.05
    power = torch.fft.rfft(noise).abs().square().mean(0)[1:-1]
    frequency = torch.fft.rfftfreq(length)[1:-1]
    x, y = frequency.log() - frequency.log().mean(), power.log() - power.log().mean()
    assert abs(float((x * y).sum() / x.square().sum()) + beta) < 0.05


@pytest.mark.parametrize("length", [1, 2, 3])
def test_short_noise_has_unit_variance(length):
    assert abs(float(coloured((50000, length), 2.0, seeded()).var()) - 1.0) < 0.05


def with_gradient(score):
    def both(actions: Tensor) -> tuple[Tensor, Tensor]:
        leaf = actions.detach().requires_grad_()
        scores = score(leaf)
        return scores.detach(), torch.autograd.grad(scores.sum(), leaf)[0]

    return both


def test_refinement_climbs_to_the_optimum_and_stays_within_bounds():
    score = quadratic(OUTSIDE)
    found = refine(score, with_gradient(score), torch.zeros(3, *SHAPE), steps=60, rate=0.15)
    assert found.valid
    assert (found.best - OUTSIDE.clamp(-1, 1)).abs().max() < 0.02


def test_refinement_is_never_worse_than_its_start():
    score = quadratic(INSIDE)
    found = refine(score, with_gradient(score), INSIDE[None], steps=3, rate=0.9)
    assert torch.equal(found.best, INSIDE)


def test_a_broken_gradient_takes_no_step_and_leaves_the_others_alone():
    score = quadratic(INSIDE)

    def both(actions: Tensor) -> tuple[Tensor, Tensor]:
        values, gradient = with_gradient(score)(actions)
        gradient[0] = math.nan
        return values, gradient

    found = refine(score, both, torch.zeros(2, *SHAPE), steps=60, rate=0.15)
    assert (found.best - INSIDE).abs().max() < 0.04
    assert torch.equal(found.elites[1], torch.zeros(SHAPE))


def test_refinement_without_a_finite_score_says_so():
    def score(actions: Tensor) -> Tensor:
        return actions.sum((1, 2)) * math.nan

    found = refine(score, with_gradient(score), torch.ones(2, *SHAPE), steps=2, rate=0.1)
    assert not found.valid
    assert torch.equal(found.best, torch.ones(SHAPE))

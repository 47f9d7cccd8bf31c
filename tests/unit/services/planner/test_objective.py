"""Eq. (5): its terms, their signs, and what becomes of diverged candidates."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from common.task import get_task
from services.planner.config import PlannerConfig
from services.planner.objective import Objective
from tests.unit.services.planner.models import LineTask, objective

H, P, N = 3, 2, 4
TASK = LineTask()
START = torch.randn(P, 1, 2, generator=torch.Generator().manual_seed(0))
STATES = torch.randn(H, P, N, 2, generator=torch.Generator().manual_seed(1))
GOAL = torch.tensor([0.5])


def by_hand(smooth: float = 0.0, disagreement: float = 0.0) -> torch.Tensor:
    scores = torch.zeros(N)
    for n in range(N):
        returns = torch.zeros(P)
        for p in range(P):
            before = START[p, 0]
            for h in range(H):
                state = STATES[h, p, n]
                returns[p] += TASK.reward(state, GOAL) - smooth * (state[0] - before[0]).abs()
                before = state
        scores[n] = returns.mean() - disagreement * returns.std(correction=0)
    return scores


def test_rewards_of_predicted_states_are_summed_over_steps_and_averaged_over_particles():
    torch.testing.assert_close(objective(TASK)(START, STATES, GOAL), by_hand())


def test_smoothing_is_subtracted_and_acts_on_its_dimensions_alone():
    torch.testing.assert_close(objective(TASK, smooth_weight=0.3)(START, STATES, GOAL), by_hand(smooth=0.3))


def test_disagreement_lowers_the_score():
    torch.testing.assert_close(
        objective(TASK, disagreement_weight=0.7)(START, STATES, GOAL), by_hand(disagreement=0.7)
    )


def test_the_tail_repeats_the_last_reward_until_the_episode_ends():
    last = torch.stack([TASK.reward(STATES[-1, :, n], GOAL).mean() for n in range(N)])
    tailed = objective(TASK, tail_steps=5.0)
    for left, repeated in ((9, 5.0), (2, 2.0), (-1, 0.0)):
        torch.testing.assert_close(tailed.until(left)(START, STATES, GOAL), by_hand() + repeated * last)


def test_further_terms_are_added():
    term = replace(objective(TASK), smooth_slices=(), terms=(lambda states: 0.0 * states[0, ..., 0] + 2.0,))
    torch.testing.assert_close(term(START, STATES, GOAL), by_hand() + 2.0)


def test_a_diverged_candidate_scores_minus_infinity():
    states = STATES.clone()
    states[1, 0, 0, 0] = math.nan
    states[2, 1, 1, 1] = math.inf
    states[0, 1, 2, 0] = 1e4
    scores = objective(TASK, smooth_weight=0.1)(START, states, GOAL)
    assert scores[:3].tolist() == [-math.inf] * 3
    assert math.isfinite(scores[3])


def test_the_configuration_chooses_sign_and_groups():
    egg = get_task("egg")
    smoothed = Objective.create(egg, PlannerConfig())
    assert smoothed.smooth_weight == 0.01
    assert [part.start for part in smoothed.smooth_slices] == [0, 54, 57]
    printed = Objective.create(egg, PlannerConfig(smooth_sign="printed", smooth_groups=("qvel",)))
    assert printed.smooth_weight == -0.01
    assert printed.smooth_slices == (slice(24, 48),)


def test_the_residuals_norms_add_up_to_the_score():
    task = get_task("reach")
    generator = torch.Generator().manual_seed(2)
    start, states = (0.1 * torch.rand(*shape, 63, generator=generator) for shape in [(P, 1), (H, P, N)])
    goal = torch.rand(15, generator=generator)
    scored = Objective.create(task, PlannerConfig(smooth_weight=0.3, tail_steps=4.0))
    parts = scored.residuals(start, states, goal)
    norms = sum(part.norm(dim=-1).flatten(0, -2).sum(0) for part in parts)
    torch.testing.assert_close(-norms / P, scored(start, states, goal))


def test_an_object_that_leaves_the_hand_costs_by_the_metre():
    task = get_task("egg_rotate")
    plain, priced = (
        Objective.create(task, PlannerConfig(smooth_weight=0.0, stray_weight=stray, sink_weight=sink))
        for stray, sink in ((0.0, 0.0), (10.0, 20.0))
    )
    states = torch.zeros(2, 1, 3, 61)
    states[..., 54:57] = torch.tensor([1.009, 0.871, 0.17])
    states[..., 57] = 1.0
    states[0, 0, 1, 55] += 0.05  # 30 mm beyond the middle's 20, in one of two steps
    states[:, 0, 2, 56] -= 0.04  # 30 mm too low in both
    cost = plain(states[:1, :, 0], states, states[0, 0, 0, 54:]) - priced(
        states[:1, :, 0], states, states[0, 0, 0, 54:]
    )
    torch.testing.assert_close(cost, torch.tensor([0.0, 0.3, 1.2]), atol=1e-4, rtol=0)

"""What the model misses at rest is learned and taken away; what it misses in motion is not."""

from __future__ import annotations

import pytest
import torch

from common.model.coordinates import RawCoordinates
from services.planner.config import PlannerConfig
from services.planner.correction import Correction
from services.planner.mpc import Mpc
from services.planner.particles import Layer, Network, Particles
from tests.unit.services.planner.models import LineTask, seeded

S, A = 2, 1
RAW = RawCoordinates(S, A)
MOST = torch.tensor([0.1, 0.0])
BIAS = torch.tensor([0.04, 0.3])
# Two linear particles, s' = s + gain·a, of a plant that is pushed aside as well: s' = s + 0.5·a + BIAS.
GAINS = torch.tensor([0.5, 0.4])


def model() -> Particles:
    weight = torch.zeros(2, S + A, S)
    weight[:, S, 0] = GAINS
    return Particles(Network([Layer(weight, torch.zeros(2, 1, S))]), RAW)


def moved(state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    return state + torch.cat((0.5 * action, torch.zeros(1))) + BIAS


def rest(steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    states = [torch.zeros(S)]
    for _ in range(steps):
        states.append(moved(states[-1], torch.zeros(A)))
    return torch.stack(states), torch.zeros(steps, A)


def predicted(correction: Correction) -> torch.Tensor:
    return correction.of(model()).step(torch.zeros(2, 1, S), torch.zeros(1, A))[:, 0]


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_each_step_at_rest_takes_a_share_of_what_is_left_where_it_is_wanted(steps):
    correction = Correction(0.25, MOST, slow=1.0)
    correction.observe(model(), *rest(steps))
    expected = torch.tensor([0.04 * (1 - 0.75**steps), 0.0])
    torch.testing.assert_close(predicted(correction), expected.expand(2, S))


def test_a_step_counts_for_no_more_than_the_bound():
    correction = Correction(0.5, torch.tensor([0.01, 0.0]), slow=9.0)
    correction.observe(model(), *rest(1))
    torch.testing.assert_close(predicted(correction)[:, 0], torch.full((2,), 0.005))


def test_fast_steps_let_the_estimate_fade():
    correction = Correction(0.5, MOST, slow=1.0)
    correction.observe(model(), *rest(1))
    action = torch.ones(1, A)
    fast = torch.stack((torch.zeros(S), moved(torch.zeros(S), action[0])))
    correction.observe(model(), fast, action)
    torch.testing.assert_close(predicted(correction)[:, 0], torch.full((2,), 0.01))


def test_nothing_is_learned_from_what_is_not_finite_and_all_is_forgotten_on_request():
    correction = Correction(0.5, MOST, slow=1.0)
    correction.observe(model(), torch.tensor([[0.0, 0.0], [torch.nan, 0.0]]), torch.zeros(1, A))
    assert torch.equal(predicted(correction), torch.zeros(2, S))
    correction.observe(model(), *rest(3))
    correction.reset()
    assert torch.equal(predicted(correction), torch.zeros(2, S))


@pytest.mark.parametrize(("share", "left"), [(0.0, 0.04), (0.5, 0.0)])
def test_planning_ends_at_the_goal_although_the_plant_is_pushed_aside(share, left):
    config = PlannerConfig(
        preset="fast", horizon=1, search="none", smooth_weight=0.0, refine_steps=8, correction=share
    )
    mpc, correction = Mpc(config, LineTask()), Correction(share, MOST, slow=1.0)
    plain = Particles(
        Network([Layer(layer.weight[:1], layer.bias[:1]) for layer in model().network.layers]), RAW
    )
    state, goal = torch.zeros(S), torch.tensor([0.8])
    mpc.set_model(plain)
    for k in range(40):
        action = mpc.plan(state, goal, torch.zeros(0, A), 50 - k, seeded()).actions[0]
        after = torch.stack((moved(state, action)[0], torch.tensor(0.0)))
        correction.observe(plain, torch.stack((state, after)), action[None])
        mpc.set_model(correction.of(plain))
        state = after
    assert float(state[0]) - 0.8 == pytest.approx(left, abs=2e-3)

"""Whole plans on a point mass, whose optimal control is a linear system of equations."""

from __future__ import annotations

import math

import pytest
import torch

from services.planner.config import PlannerConfig
from services.planner.mpc import Mpc, steps_per_plan
from tests.unit.services.planner.models import Linear, LineTask, objective, point_mass, seeded

TASK = LineTask()
GOAL = torch.tensor([0.4])
REST = torch.zeros(2)
NONE = torch.empty(0, 1)
H = 8


def config(**values) -> PlannerConfig:
    fixed = {"preset": "fast", "horizon": H, "knots": 0, "smooth_weight": 0.0, "iterations": 2}
    return PlannerConfig(**(fixed | values))


def planner(settings: PlannerConfig, model: Linear | None = None, **weights: float) -> Mpc:
    mpc = Mpc(settings, TASK, objective(TASK, **weights))  # type: ignore[arg-type]
    mpc.set_model(model or point_mass())
    return mpc


def textbook(state: torch.Tensor, model: Linear) -> torch.Tensor:
    """Optimal actions (H, 1) of one plan by least squares, bounds ignored."""
    A, B = model.A[0].double().T, model.B[0].double().T
    free, forced = [], []
    for h in range(1, H + 1):
        power = [torch.linalg.matrix_power(A, i) for i in range(h + 1)]
        free.append(power[h] @ state.double())
        row = [power[h - 1 - j] @ B if j < h else torch.zeros(2, 1).double() for j in range(H)]
        forced.append(torch.cat(row, 1))
    weight = torch.tensor([1.0, math.sqrt(0.05)]).double()
    lhs = torch.cat([weight[:, None] * f for f in forced])
    rhs = torch.cat([weight * (torch.tensor([0.4, 0.0]).double() - f) for f in free])
    return torch.linalg.lstsq(lhs, rhs[:, None]).solution.float()


NEAR = torch.tensor([0.35, 0.05])  # from here the optimum is inside the bounds


@pytest.mark.parametrize(
    "settings",
    [
        config(candidates=400, elites=40, iterations=30, momentum=0.5, noise_beta=0.0, refine_steps=0),
        config(refine="adam", refine_sequences=4, refine_steps=300, refine_rate=0.03),
        config(search="none", refine="adam", refine_sequences=4, refine_steps=300, refine_rate=0.03),
        config(search="none", refine_steps=30),
    ],
    ids=["icem", "hybrid", "gradient", "gauss-newton"],
)
def test_without_committed_actions_it_is_textbook_mpc(settings):
    wanted = textbook(NEAR, point_mass())
    assert wanted.abs().max() < 1.0
    plan = planner(settings).plan(NEAR, GOAL, NONE, 50, seeded())
    assert plan.valid
    torch.testing.assert_close(plan.actions[0], wanted[0], atol=0.1, rtol=0.0)
    model, best = point_mass(), 0.0
    state = NEAR
    for action in wanted:
        state = model.step(state.expand(1, 1, 2), action[None])[0, 0]
        best += float(TASK.reward(state, GOAL))
    assert plan.score == pytest.approx(best, rel=0.05, abs=1e-4)


@pytest.mark.parametrize("ahead", [0, 2])
@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_it_brings_the_mass_to_the_goal(ahead, preset):
    settings = PlannerConfig(preset=preset, horizon=10, knots=0, candidates=100, elites=10, iterations=3)
    mpc, model = planner(settings), point_mass()
    state, generator = REST, seeded()
    buffer = [torch.zeros(1)] * ahead
    for k in range(0, 40, max(ahead, 1)):
        committed = torch.stack(buffer) if ahead else NONE
        plan = mpc.plan(state, GOAL, committed, 40 - k, generator)
        for action in buffer or [plan.actions[0]]:
            state = model.step(state.expand(1, 1, 2), action[None])[0, 0]
        buffer = list(plan.actions[:ahead])
    assert abs(float(state[0] - GOAL)) < 0.02
    assert abs(float(state[1])) < 0.1


def test_planning_ahead_equals_planning_from_the_predicted_state():
    committed = torch.tensor([[0.5], [-0.3]])
    later = REST
    for action in committed:
        later = point_mass().step(later.expand(1, 1, 2), action[None])[0, 0]
    ahead = planner(config()).plan(REST, GOAL, committed, 50, seeded())
    there = planner(config()).plan(later, GOAL, NONE, 48, seeded())
    assert torch.equal(ahead.actions, there.actions)
    assert ahead.predicted_mean.shape == (2 + H, 2)
    assert torch.equal(ahead.predicted_mean[1], later)
    assert torch.equal(ahead.predicted_mean[2:], there.predicted_mean)


def test_the_prediction_is_that_of_the_planned_actions():
    model = point_mass((0.5, 1.5))
    plan = planner(config(), model).plan(REST, GOAL, NONE, 50, seeded())
    state = REST.expand(2, 1, 2)
    for h, action in enumerate(plan.actions):
        state = model.step(state, action[None])
        torch.testing.assert_close(plan.predicted_mean[h], state[:, 0].mean(0))
        torch.testing.assert_close(plan.predicted_std[h], state[:, 0].std(0, correction=0))


@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_same_seed_same_plans(preset):
    def plans(seed: int) -> list[torch.Tensor]:
        mpc, generator = planner(PlannerConfig(preset=preset, horizon=H)), seeded(seed)
        return [mpc.plan(REST, GOAL, NONE, 50 - k, generator).actions for k in range(3)]

    for first, again, other in zip(plans(1), plans(1), plans(2), strict=True):
        assert torch.equal(first, again)
        assert not torch.equal(first, other)


def travel(smooth_weight: float) -> float:
    settings = config(candidates=300, elites=20, iterations=10, refine_steps=0)
    plan = planner(settings, smooth_weight=smooth_weight).plan(REST, GOAL, NONE, 50, seeded())
    path = torch.cat((REST[None], plan.predicted_mean))[:, 0]
    return float(path.diff().abs().sum())


def test_smoothing_lowers_the_state_change_and_the_printed_sign_raises_it():
    assert travel(0.5) < 0.9 * travel(0.0) < 0.8 * travel(-5.0)


def test_a_diverging_model_yields_the_warm_start_and_says_so():
    mpc = planner(config(), Linear(torch.full((1, 2, 2), math.nan), torch.ones(1, 1, 2)))
    plan = mpc.plan(REST, GOAL, NONE, 50, seeded())
    assert not plan.valid
    assert torch.equal(plan.actions, torch.zeros(H, 1))


class Recorded:
    """A model that keeps the actions of the first batch of candidates of each plan."""

    particles = 1

    def __init__(self) -> None:
        self.first: list[torch.Tensor] = []

    def step(self, state, action, noise=None):
        if state.shape[1] == 1:
            self.first.append(action.detach())
        return point_mass().step(state, action)


def first_candidates(events) -> tuple[torch.Tensor, torch.Tensor]:
    """First actions tried in the last plan, and the plan made before it."""
    model, mpc = Recorded(), Mpc(config(keep_fraction=1.0), TASK, objective(TASK))  # type: ignore[arg-type]
    mpc.set_model(model)
    before = mpc.plan(REST, GOAL, NONE, 50, seeded()).actions
    model.first.clear()
    goal, left = events(mpc)
    mpc.plan(REST, goal, NONE, left, seeded(1))
    return model.first[0], before


def test_elites_are_kept_and_shifted_by_the_steps_in_between():
    tried, before = first_candidates(lambda mpc: (GOAL, 47))
    assert torch.isclose(tried[:, 0], before[3]).any()


@pytest.mark.parametrize(
    "events",
    [
        lambda mpc: (mpc.reset(), (GOAL, 47))[1],
        lambda mpc: (GOAL + 0.1, 47),
        lambda mpc: (GOAL, 60),
    ],
    ids=["reset", "another goal", "an episode that starts again"],
)
def test_elites_are_cleared(events):
    tried, before = first_candidates(events)
    assert len(tried) == 1 + config().candidates  # the zero action, and fresh ones
    assert not torch.isclose(tried[:, 0], before[3]).any()


def test_the_horizon_may_end_with_the_episode():
    mpc = planner(config(horizon_to_episode_end=True))
    assert len(mpc.plan(REST, GOAL, torch.zeros(2, 1), 7, seeded()).actions) == 5
    assert len(mpc.plan(REST, GOAL, torch.zeros(2, 1), 2, seeded()).actions) == 1


def test_a_plan_without_a_model_is_refused():
    mpc = Mpc(config(), TASK)  # type: ignore[arg-type]
    with pytest.raises(RuntimeError, match="set_model"):
        mpc.plan(REST, GOAL, NONE, 50, seeded())


def test_x_is_the_number_of_steps_that_a_plan_takes():
    assert [steps_per_plan(25.0, s) for s in (0.001, 0.04, 0.041, 0.1)] == [1, 1, 2, 3]
    assert steps_per_plan(3.0, 0.5) == 2

"""The oracle predicts what the plant then does, to the bit, and its plans turn the egg the right way."""

import numpy as np
import pytest
import torch

from bench.oracle import Budget, Oracle, SimulatorPredictor
from services.planner.config import PlannerConfig
from services.sim.plant import ShadowHandPlant

SEED = 1_000_000


@pytest.fixture(scope="module")
def plant():
    return ShadowHandPlant("egg_rotate")


def test_predictions_are_the_plants_own_steps_to_the_bit(plant):
    rng = np.random.default_rng(0)
    plant.reset(SEED)
    for _ in range(3):  # into contact, with a warm start of the solver
        plant.step(rng.uniform(-1, 1, 20))
    generator = torch.Generator().manual_seed(0)
    here = plant.save()
    actions = torch.rand(2, 4, 20, generator=generator) * 2.2 - 1.1  # beyond the limits, too
    predicted = SimulatorPredictor(plant).candidates(torch.zeros(0), actions)
    assert predicted.shape == (4, 1, 2, 61)
    assert np.array_equal(plant.save().physics, here.physics)
    for n in range(2):
        plant.restore(here)
        steps = [plant.step(action).astype(np.float32) for action in actions[n].double().numpy()]
        np.testing.assert_array_equal(predicted[:, 0, n].numpy(), steps)


def test_committed_actions_are_refused(plant):
    with pytest.raises(ValueError, match="no committed actions"):
        SimulatorPredictor(plant).prefix(torch.zeros(61), torch.zeros(1, 20))


def test_a_budget_replaces_the_cells_search_and_nothing_else():
    cell = PlannerConfig.model_validate({"preset": "fast", "stray_weight": 10.0})
    config = Budget(20, 2, 6, 3).applied(cell)
    assert (config.candidates, config.iterations, config.horizon, config.knots) == (20, 2, 6, 3)
    assert (config.elites, config.search, config.refines) == (5, "icem", False)
    assert config.stray_weight == 10.0 and config.smooth_weight == cell.smooth_weight


def test_an_episode_of_plans_comes_nearer_than_none(plant):
    config = Budget(8, 1, 5, 2).applied(PlannerConfig.model_validate({"preset": "fast"}))
    oracle = Oracle("egg_rotate", config, x=5)
    states, actions = oracle.run(SEED)
    errors = plant.task.errors(states, oracle.plant.goal)["rotation_rad"]
    assert states.shape == (51, 61) and actions.shape == (50, 20)
    assert errors[:25].min() < errors[0] - 0.1
    again = oracle.score(SEED)
    assert again["error_rotation_rad"] == errors[-1] and again["success_paper"] == (errors[-1] < 0.5)

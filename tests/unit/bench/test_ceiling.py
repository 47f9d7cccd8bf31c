"""The ceiling's parts: its slope predicts the simulator, a descent only improves, and results add up."""

import numpy as np
import pytest

from bench import ceiling
from services.sim.plant import ShadowHandPlant

SEED = 1_000_000


@pytest.fixture(scope="module")
def plant():
    return ShadowHandPlant("reach")


def test_holding_is_repeatable_and_reports_the_end(plant):
    action = np.zeros(20)
    first, second = ceiling.hold(plant, SEED, action), ceiling.hold(plant, SEED, action)
    assert np.array_equal(first.residual_m, second.residual_m)
    errors = plant.task.errors(plant.state, plant.goal)
    assert first.mean_finger_m == pytest.approx(errors["mean_finger_m"])
    assert first.episode_return < 0


def test_slope_predicts_where_a_small_change_of_the_held_action_leads(plant):
    action = np.full(20, 0.1)
    start = ceiling.hold(plant, SEED, action)
    slope = ceiling.jacobian(plant, action)
    change = np.random.default_rng(0).uniform(-0.02, 0.02, 20)
    moved = ceiling.hold(plant, SEED, action + change).residual_m - start.residual_m
    # Friction makes where a joint rests depend on where it came from, so a quarter stays unexplained.
    assert np.linalg.norm(slope @ change - moved) < 0.4 * np.linalg.norm(moved)


def test_descent_only_improves(plant, monkeypatch):
    monkeypatch.setattr(ceiling, "_ITERATIONS", 2)
    start = np.zeros(20)
    before, after = ceiling.hold(plant, SEED, start), ceiling.descend(plant, SEED, start)
    assert np.linalg.norm(after.residual_m) < 0.7 * np.linalg.norm(before.residual_m)
    assert np.abs(after.action).max() <= 1


def test_summary_carries_rates_with_intervals():
    results = [
        ceiling.GoalResult(s, 0.001 * s, 0.002, 0.003, -1.0, {"success_paper": s < 2}) for s in range(1, 5)
    ]
    summary = ceiling.summarise(results)
    assert summary["mean_finger_m"] == pytest.approx(0.0025)
    assert summary["success_paper"] == {"rate": 0.25, "wilson_95": pytest.approx((0.0456, 0.6994), abs=1e-3)}

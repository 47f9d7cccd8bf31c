"""Held postures: their slope predicts the simulator, and a descent only improves."""

import numpy as np
import pytest

from bench import held_posture
from services.sim.plant import ShadowHandPlant

SEED = 1_000_000


@pytest.fixture(scope="module")
def plant():
    return ShadowHandPlant("reach")


def test_holding_is_repeatable_and_reports_the_end(plant):
    action = np.zeros(20)
    first, second = held_posture.hold(plant, SEED, action), held_posture.hold(plant, SEED, action)
    assert np.array_equal(first.residual_m, second.residual_m)
    errors = plant.task.errors(plant.state, plant.goal)
    assert first.mean_finger_m == pytest.approx(errors["mean_finger_m"])
    assert first.episode_return < 0


def test_slope_predicts_where_a_small_change_of_the_held_action_leads(plant):
    action = np.full(20, 0.1)
    start = held_posture.hold(plant, SEED, action)
    slope = held_posture.jacobian(plant, action)
    change = np.random.default_rng(0).uniform(-0.02, 0.02, 20)
    moved = held_posture.hold(plant, SEED, action + change).residual_m - start.residual_m
    # Friction makes where a joint rests depend on where it came from, so a quarter stays unexplained.
    assert np.linalg.norm(slope @ change - moved) < 0.4 * np.linalg.norm(moved)


def test_descent_only_improves(plant, monkeypatch):
    monkeypatch.setattr(held_posture, "_ITERATIONS", 2)
    start = np.zeros(20)
    before, after = held_posture.hold(plant, SEED, start), held_posture.descend(plant, SEED, start)
    assert np.linalg.norm(after.residual_m) < 0.7 * np.linalg.norm(before.residual_m)
    assert np.abs(after.action).max() <= 1

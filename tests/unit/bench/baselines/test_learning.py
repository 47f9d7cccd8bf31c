"""Each method learns a task with a known answer, twice the same way, and after a stop as without it."""

import numpy as np
import pytest
import torch

from bench.baselines import ddpg_her, sac, td7, tdmpc
from tests.unit.bench.baselines.toys import (
    Dials,
    PointMass,
    episode,
    evaluate,
    remember_warm_up,
    train,
    warm_up,
)

SMALL = {
    "sac": (sac, {"hidden": (64, 64), "buffer": 2000, "learning_rate": 3e-3, "discount": 0.8}),
    "ddpg_her": (ddpg_her, {"hidden": (64, 64), "buffer": 2000}),
    "td7": (
        td7,
        {
            "embedding": 32,
            "hidden": 64,
            "batch": 64,
            "target_update_every": 25,
            "learning_rate": 1e-3,
            "discount": 0.8,
        },
    ),
    "tdmpc": (
        tdmpc,
        {
            "batch": 64,
            "samples": 64,
            "elites": 8,
            "hidden": 64,
            "encoder": 64,
            "latent": 16,
            "horizon": 3,
            "schedule_steps": 400,
            "discount": 0.9,
        },
    ),
}
NOTHING, BEST = -11.22, -2.76  # returns of standing still and of the best actions, over the held-out goals


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def make(name, task=None, **changes):
    module, settings = SMALL[name]
    return module.Agent(module.Config(**{**settings, **changes}), task or PointMass(), seed=0)


@pytest.mark.parametrize(
    ("name", "warmups", "episodes"),
    [("sac", 40, 20), ("ddpg_her", 20, 10), ("td7", 50, 30), ("tdmpc", 40, 10)],
)
def test_it_brings_a_point_to_its_goal(name, warmups, episodes):
    agent = make(name)
    train(agent, PointMass(), warmups, episodes)
    earned, best = evaluate(agent, PointMass())
    assert best == pytest.approx(BEST, abs=0.01)
    assert earned > BEST + 0.25 * (NOTHING - BEST)


def test_pretended_goals_teach_what_a_sparse_reward_does_not():
    returns = {}
    for pretended in (4, 0):
        agent = make("ddpg_her", Dials(), relabelled_per_real=pretended)
        train(agent, Dials(), 40, 40)
        returns[pretended], best = evaluate(agent, Dials())
    assert best == pytest.approx(-1.45)
    assert returns[4] > best - 0.5
    assert returns[0] == -10.0


def actions_of(agent, explore):
    agent.begin(5, explore)
    return episode(PointMass(), agent.act, seed=3).actions


def set_global_chance(seed):
    torch.manual_seed(seed)
    np.random.seed(seed)  # noqa: NPY002


def global_draw():
    return torch.rand(1).item(), np.random.rand()  # noqa: NPY002


@pytest.mark.parametrize("name", SMALL)
def test_the_same_seed_learns_and_acts_the_same_and_leaves_global_chance_alone(name):
    agents = [make(name), make(name)]
    for position, agent in enumerate(agents):
        set_global_chance(position)
        warm_up(agent, PointMass(), 3)
        drawn = global_draw()
        set_global_chance(position)
        assert drawn == global_draw()
    first, second = (agent.tensors() for agent in agents)
    assert first.keys() == second.keys()
    for key, tensor in first.items():
        assert torch.equal(tensor, second[key]), key
    for explore in (True, False):
        np.testing.assert_array_equal(actions_of(agents[0], explore), actions_of(agents[1], explore))
    assert not np.array_equal(actions_of(agents[0], True), actions_of(agents[0], False))


@pytest.mark.parametrize("name", SMALL)
def test_an_agent_that_was_stopped_goes_on_as_if_it_was_not(name):
    steady, stopped = make(name), make(name)
    warm_up(steady, PointMass(), 3)
    remember_warm_up(stopped, PointMass(), 3)
    stopped.restore(steady.tensors())
    for agent in (steady, stopped):
        agent.begin(7, explore=True)
        agent.remember(episode(PointMass(), agent.act, seed=9))
        agent.learn(30, seed=11)
    first, second = steady.tensors(), stopped.tensors()
    for key, tensor in first.items():
        assert torch.equal(tensor, second[key]), key
    np.testing.assert_array_equal(actions_of(steady, False), actions_of(stopped, False))

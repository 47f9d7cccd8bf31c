"""Hindsight relabelling, and what stable-baselines3 is told, against a short episode worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from bench.baselines import ddpg_her, sac
from bench.baselines.controller import Trajectory
from bench.baselines.stable import GoalSpaces
from common.task import get_task
from tests.unit.bench.baselines.toys import PointMass

TASK = PointMass()
POSITIONS = np.array([[0, 0], [0.1, 0], [0.3, 0], [0.3, 0.2], [0.1, 0.2]], np.float32)
GOAL = np.array([1.0, 0.4], np.float32)
WALK = Trajectory(
    POSITIONS,
    np.array([[0.5, 0], [1, 0], [0, 1], [-1, 0]], np.float32),
    TASK.env_reward(POSITIONS[1:], GOAL).astype(np.float32),
    GOAL,
    True,
)
FAR = POSITIONS + 5


def drawn(agent, count=400):
    np.random.seed(0)  # noqa: NPY002 - what stable-baselines3 draws from
    return agent._model.replay_buffer.sample(count)


@pytest.fixture(scope="module")
def relabelled():
    agent = ddpg_her.Agent(ddpg_her.Config(hidden=(8,), buffer=100), TASK, 0)
    agent.remember(WALK)
    agent.remember(replace(WALK, states=FAR, rewards=TASK.env_reward(FAR[1:], GOAL)))
    return drawn(agent)


def test_four_of_five_goals_are_pretended_and_come_from_later_in_the_same_episode(relabelled):
    goals = relabelled.observations["desired_goal"].numpy()
    states = relabelled.observations["observation"].numpy()
    real = (goals == GOAL).all(axis=1)
    assert real.sum() == 80
    for state, goal in zip(states[~real], goals[~real], strict=True):
        walk = FAR if state[0] >= 5 else POSITIONS
        now = int(np.flatnonzero((walk == state).all(axis=1))[0])
        assert (walk[now + 1 :] == goal).all(axis=1).any(), (state, goal)


def test_every_attained_later_goal_is_drawn(relabelled):
    from_start = (relabelled.observations["observation"].numpy() == POSITIONS[0]).all(axis=1)
    goals = {tuple(goal) for goal in relabelled.observations["desired_goal"].numpy()[from_start]}
    assert goals == {tuple(goal) for goal in (*POSITIONS[1:], GOAL)}


def test_a_pretended_goal_is_rewarded_as_the_environment_would(relabelled):
    attained = relabelled.next_observations["achieved_goal"].numpy()
    goals = relabelled.observations["desired_goal"].numpy()
    wanted = -np.linalg.norm(attained - goals, axis=1)
    np.testing.assert_allclose(relabelled.rewards[:, 0], wanted, atol=1e-6)
    first_to_last = (np.isclose(attained, POSITIONS[1]) & np.isclose(goals, POSITIONS[3])).all(axis=1)
    np.testing.assert_allclose(relabelled.rewards[first_to_last, 0], -np.sqrt(0.08), rtol=1e-6)


def test_episodes_end_by_time_so_no_value_is_cut_off(relabelled):
    assert not relabelled.dones.any()


def test_sac_learns_from_the_goals_that_were_pursued():
    agent = sac.Agent(sac.Config(hidden=(8,), buffer=100), TASK, 0)
    agent.remember(WALK)
    sample = drawn(agent)
    np.testing.assert_array_equal(sample.observations["desired_goal"], np.tile(GOAL, (400, 1)))
    moved = (sample.next_observations["observation"] - sample.observations["observation"]).numpy()
    np.testing.assert_allclose(moved, 0.2 * sample.actions, atol=1e-6)
    assert not sample.dones.any()


@pytest.mark.parametrize("name", ["reach", "egg", "egg_rotate", "block", "die"])
def test_rewards_are_those_of_the_task(name):
    task = get_task(name)
    states = np.random.default_rng(0).normal(size=(6, task.state_dim))
    goals = np.random.default_rng(1).normal(size=(6, task.goal_dim))
    found = GoalSpaces(task).compute_reward(task.achieved(states), goals, [{}] * 6)
    np.testing.assert_array_equal(found, task.env_reward(states, goals))


def test_exploration_is_three_tenths_random():
    agent = ddpg_her.Agent(ddpg_her.Config(hidden=(8,), buffer=100, noise=0.01), TASK, 0)
    agent.begin(0, explore=False)
    mean = agent.act(POSITIONS[0], GOAL)
    agent.begin(0, explore=True)
    tries = np.array([agent.act(POSITIONS[0], GOAL) for _ in range(300)])
    near = (np.abs(tries - mean) < 0.06).all(axis=1)
    assert 0.6 < near.mean() < 0.8
    assert np.abs(tries).max() <= 1.0

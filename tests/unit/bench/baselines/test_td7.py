"""TD7's parts against numbers worked out by hand."""

import numpy as np
import pytest
import torch

from bench.baselines import td7
from bench.baselines.controller import Trajectory
from tests.unit.bench.baselines.toys import PointMass

TASK = PointMass()
SMALL = td7.Config(embedding=8, hidden=8, batch=16)


def test_lap_priorities_are_the_worse_error_to_the_power_and_never_below_one():
    error = torch.tensor([[0.2, 0.9], [1.0, 3.0], [32.0, 2.0]])
    # max(|δ|, 1)^0.4: 1, 3^0.4 = 1.551846, 32^0.4 = 2^2 = 4
    np.testing.assert_allclose(td7.lap_priority(error, 0.4, 1.0), [1.0, 1.551846, 4.0], rtol=1e-6)


def test_the_huber_loss_is_quadratic_below_one_and_linear_above():
    error = torch.tensor([[0.5, 2.0], [1.0, 0.0]])
    # (0.5 · 0.25 + 2) and (1 + 0), mean 1.5625; the linear part has no offset, as in LAP's equation 7
    assert float(td7.lap_huber(error)) == pytest.approx(1.5625)


def test_average_l1_norm_brings_the_mean_magnitude_to_one():
    x = torch.tensor([[1.0, -3.0], [0.0, 0.0]])
    np.testing.assert_allclose(td7.average_l1_norm(x), [[0.5, -1.5], [0.0, 0.0]])


def constant_critic(agent, first, second):
    """Makes both target Qs constants."""
    for value, constant in zip(agent.critic_target.values, (first, second), strict=True):
        for parameter in value.parameters():
            torch.nn.init.zeros_(parameter)
        torch.nn.init.constant_(value.rest[-1].bias, constant)


def batch_of(rewards):
    rows = len(rewards)
    zeros = torch.zeros(rows, TASK.state_dim + TASK.goal_dim)
    return td7.Batch(zeros, torch.zeros(rows, TASK.action_dim), torch.tensor(rewards)[:, None], zeros)


def test_the_value_target_takes_the_smaller_q_within_the_range_seen_before():
    agent = td7.Agent(SMALL, TASK, seed=0)
    constant_critic(agent, -3.0, -2.0)
    batch = batch_of([-1.0, -0.5])
    noise = torch.zeros_like(batch.action)
    # The range is [0, 0] at first, so targets are the rewards alone.
    np.testing.assert_allclose(agent._value_target(batch, noise)[:, 0], [-1.0, -0.5])
    agent._update_targets()
    constant_critic(agent, -3.0, -2.0)
    # Now [-1, -0.5]: the smaller Q, -3, counts as -1, discounted by 0.99.
    np.testing.assert_allclose(agent._value_target(batch, noise)[:, 0], [-1.99, -1.49], rtol=1e-6)
    agent._update_targets()
    constant_critic(agent, -1.75, 5.0)
    np.testing.assert_allclose(agent._value_target(batch, noise)[:, 0], [-2.7325, -2.2325], rtol=1e-6)


def earning(reward, planned=True):
    states = np.zeros((2, 2), np.float32)
    return Trajectory(
        states, np.zeros((1, 2), np.float32), np.full(1, reward, np.float32), states[0], planned
    )


def test_a_policy_that_earned_more_than_the_checkpoint_becomes_it():
    agent = td7.Agent(SMALL, TASK, seed=0)
    weight, kept = agent.actor.first.weight, agent.checkpoint_actor.first.weight

    def policy(number):
        torch.nn.init.constant_(weight, number)

    held = []
    for number, trajectory in enumerate(
        [earning(-1.0, planned=False), earning(-3.0), earning(-4.0), earning(-3.0), earning(-2.0)], start=1
    ):
        policy(float(number))
        agent.remember(trajectory)
        held.append(float(kept[0, 0]))
    assert held[1:] == [2.0, 2.0, 4.0, 5.0]  # warm-up decides nothing, an equal return suffices
    assert held[0] != 1.0
    assert agent.best_return == -2.0


def test_evaluation_acts_with_the_checkpoint_unless_told_otherwise():
    agents = [td7.Agent(td7.Config(embedding=8, hidden=8, checkpoints=on), TASK, 0) for on in (True, False)]
    actions = []
    for agent in agents:
        torch.nn.init.constant_(agent.actor.rest[-1].bias, 100.0)
        agent.begin(0, explore=False)
        actions.append(agent.act(np.zeros(2, np.float32), np.zeros(2, np.float32)))
    assert np.abs(actions[0]).max() < 1.0
    np.testing.assert_array_equal(actions[1], [1.0, 1.0])


def test_targets_follow_every_so_many_updates_and_encoders_one_round_behind():
    agent = td7.Agent(SMALL.model_copy(update={"target_update_every": 2}), TASK, 0)
    generator = torch.Generator().manual_seed(0)
    batch = td7.Batch(*(torch.randn(4, n, generator=generator) for n in (4, 2, 1, 4)))
    first = agent.encoder.f[0].weight.clone()
    agent.update(batch, torch.zeros(4, 2))
    assert torch.equal(agent.fixed_encoder.f[0].weight, first)
    agent.update(batch, torch.zeros(4, 2))
    assert torch.equal(agent.fixed_encoder.f[0].weight, agent.encoder.f[0].weight)
    assert torch.equal(agent.fixed_encoder_target.f[0].weight, first)
    assert torch.equal(agent.actor_target.first.weight, agent.actor.first.weight)

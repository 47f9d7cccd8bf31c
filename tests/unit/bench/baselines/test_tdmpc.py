"""TD-MPC's parts against numbers worked out by hand."""

import math

import numpy as np
import pytest
import torch

from bench.baselines import tdmpc
from tests.unit.bench.baselines.toys import PointMass

TASK = PointMass()
SMALL = tdmpc.Config(
    horizon=2, hidden=8, encoder=8, latent=3, samples=20, elites=4, iterations=2, batch=8, min_std=0.0
)
GENERATOR = torch.Generator()


def constant(net, value):
    """Makes a network answer with a constant."""
    for parameter in net.parameters():
        torch.nn.init.zeros_(parameter)
    with torch.no_grad():
        net[-1].bias.copy_(torch.as_tensor(value, dtype=torch.float32).expand(net[-1].bias.shape))


def simple_model(z_next, reward, values, config=SMALL):
    model = tdmpc.Told(4, 2, config)
    constant(model.h, 0.5)
    constant(model.d, z_next)
    constant(model.reward, reward)
    constant(model.pi, 0.0)
    for net, value in zip(model.q, values, strict=True):
        constant(net, value)
    return model


def test_the_value_target_is_the_reward_and_the_smaller_slow_value():
    slow = simple_model(0.0, 0.0, (-2.0, -3.0))
    z, action, reward = torch.zeros(2, 1, 3), torch.zeros(2, 1, 2), torch.tensor([[[-1.0]], [[0.5]]])
    found = tdmpc.value_target(slow, z, action, reward, 0.9)
    np.testing.assert_allclose(found[:, 0, 0], [-3.7, -2.2], rtol=1e-6)  # r - 0.9 · 3


def test_losses_are_sums_over_the_unrolled_steps_weighted_by_rho():
    model = simple_model(z_next=1.5, reward=-1.0, values=(-4.0, -6.0))
    slow = simple_model(z_next=9.0, reward=9.0, values=(-2.0, -3.0))
    batch = tdmpc.Batch(torch.zeros(3, 1, 4), torch.zeros(2, 1, 2), torch.tensor([[[-2.0]], [[-3.0]]]))
    losses = tdmpc.model_losses(model, slow, batch, SMALL, GENERATOR)
    # Latents 1.5 beside the slow encoder's 0.5; rewards off by 1 and 2; ρ = 0.5.
    assert losses.consistency.item() == pytest.approx(1 + 0.5 * 1)
    assert losses.reward.item() == pytest.approx(1 + 0.5 * 4)
    # Targets -2 - 0.99 · 3 = -4.97 and -5.97; values -4 and -6.
    errors = [(0.97, 1.03), (1.97, 0.03)]
    squares = [a * a + b * b for a, b in errors]
    assert losses.value.item() == pytest.approx(squares[0] + 0.5 * squares[1], rel=1e-5)
    assert losses.priority.item() == pytest.approx(2.0 + 0.5 * 2.0, rel=1e-5)
    np.testing.assert_allclose(losses.latents[:, 0, 0].detach(), [0.5, 1.5, 1.5])


def test_the_policy_is_trained_on_the_smaller_value_along_the_latents():
    model = simple_model(z_next=0.0, reward=0.0, values=(-4.0, -6.0))
    loss = tdmpc.policy_loss(model, torch.zeros(3, 5, 3), SMALL, GENERATOR)
    assert loss.item() == pytest.approx(6 * (1 + 0.5 + 0.25))


def test_a_sequence_is_worth_its_discounted_rewards_and_the_value_at_its_end():
    agent = tdmpc.Agent(SMALL, TASK, 0)
    agent.model = simple_model(z_next=0.0, reward=-1.0, values=(-10.0, -20.0))
    worth = agent._estimate(torch.zeros(4, 3), torch.zeros(3, 4, 2))
    np.testing.assert_allclose(worth.detach(), -1 - 0.99 - 0.99**2 - 0.99**3 * 20, rtol=1e-6)


def test_what_diverges_is_never_chosen():
    agent = tdmpc.Agent(SMALL, TASK, 0)
    inner = agent.model.next

    def diverges_upwards(z, action):
        z, reward = inner(z, action)
        return z, torch.where(action[:, :1] > 0, math.nan, reward - 1.0)

    agent.model.next = diverges_upwards
    agent.begin(0, explore=False)
    for _ in range(5):
        assert agent.act(np.zeros(2, np.float32), np.zeros(2, np.float32))[0] <= 0


def test_planning_looks_farther_and_searches_nearer_with_experience():
    agent = tdmpc.Agent(SMALL.model_copy(update={"horizon": 5, "schedule_steps": 100}), TASK, 0)
    lengths = []
    for steps in (0, 49, 50, 75, 100, 1000):
        agent.steps = steps
        agent.begin(0, explore=False)
        agent.act(np.zeros(2, np.float32), np.zeros(2, np.float32))
        lengths.append(len(agent._plan))
    assert lengths == [1, 2, 3, 4, 5, 5]


def test_the_plan_is_shifted_within_an_episode_and_forgotten_after_it():
    agent = tdmpc.Agent(SMALL.model_copy(update={"momentum": 1.0}), TASK, 0)  # the mean stays where it began
    agent.steps = 10**6
    agent._plan = torch.tensor([[0.1, 0.2], [0.3, 0.4]])
    here = np.zeros(2, np.float32)
    agent.act(here, here)
    np.testing.assert_allclose(agent._plan, [[0.3, 0.4], [0, 0]])
    agent._plan = torch.tensor([[0.1, 0.2], [0.3, 0.4]])
    agent.begin(0, explore=False)
    agent.act(here, here)
    np.testing.assert_allclose(agent._plan, [[0, 0], [0, 0]])

"""Particles through the model: explicit loops, and the printed averaging of Eq. (1)."""

from __future__ import annotations

import torch

from services.planner.rollout import Rollout, mean_and_std
from tests.unit.services.planner.models import point_mass, seeded

MODEL = point_mass((0.5, 1.0, 1.8))
STATE = torch.tensor([0.3, -0.2])
ACTIONS = torch.randn(4, 6, 1, generator=seeded())


def test_the_prefix_equals_an_explicit_loop_per_particle():
    states = Rollout(MODEL).prefix(STATE, ACTIONS[0])
    assert states.shape == (7, 3, 1, 2)
    for p in range(3):
        state = STATE
        for k in range(6):
            torch.testing.assert_close(states[k, p, 0], state)
            state = state @ MODEL.A[p] + ACTIONS[0, k] @ MODEL.B[p]
        torch.testing.assert_close(states[6, p, 0], state)


def test_an_empty_prefix_is_the_state_itself():
    states = Rollout(MODEL).prefix(STATE, torch.empty(0, 1))
    assert torch.equal(states, STATE.expand(1, 3, 1, 2))


def test_particles_stay_apart():
    start = Rollout(MODEL).prefix(STATE, ACTIONS[0, :2])[-1]
    states = Rollout(MODEL).candidates(start, ACTIONS)
    assert states.shape == (6, 3, 4, 2)
    for p in range(3):
        state = start[p, 0]
        for k in range(6):
            state = state @ MODEL.A[p] + ACTIONS[2, k] @ MODEL.B[p]
        torch.testing.assert_close(states[-1, p, 2], state)


def test_averaging_follows_equation_1_as_printed():
    start = STATE.expand(3, 1, 2)
    states = Rollout(MODEL, "average").candidates(start, ACTIONS)
    state = STATE
    for k in range(6):
        state = torch.stack([state @ MODEL.A[p] + ACTIONS[1, k] @ MODEL.B[p] for p in range(3)]).mean(0)
        torch.testing.assert_close(states[k, :, 1], state.expand(3, 2))


def test_sampling_draws_noise_and_means_do_not():
    start = STATE.expand(3, 1, 2)
    follow, drawn = (Rollout(MODEL, mode) for mode in ("particles", "sampled"))
    assert torch.equal(
        follow.candidates(start, ACTIONS, seeded(1)), follow.candidates(start, ACTIONS, seeded(2))
    )
    assert torch.equal(
        drawn.candidates(start, ACTIONS, seeded(1)), drawn.candidates(start, ACTIONS, seeded(1))
    )
    assert not torch.equal(
        drawn.candidates(start, ACTIONS, seeded(1)), drawn.candidates(start, ACTIONS, seeded(2))
    )


def test_mean_and_deviation_are_over_particles():
    states = torch.randn(5, 3, 1, 2, generator=seeded())
    mean, std = mean_and_std(states)
    torch.testing.assert_close(mean, states[:, :, 0].mean(1))
    torch.testing.assert_close(std, ((states[:, :, 0] - mean[:, None]) ** 2).mean(1).sqrt())

"""The planner's folded weights give what the model itself gives, and so do their gradients."""

from __future__ import annotations

import pytest
import torch

from common.model.choose import coordinates_of
from common.model.config import ModelConfig
from common.model.coordinates import RawCoordinates
from common.model.dynamics import Dynamics
from common.model.masks import MaskPool
from common.model.normaliser import Normaliser
from common.task import get_task
from services.planner.particles import particles
from tests.unit.services.planner.models import seeded

S, A, B, M, N = 9, 4, 3, 2, 5
HIDDEN = (32, 24, 16)
QUATERNION = slice(5, 9)
RAW = RawCoordinates(S, A, (QUATERNION,))


def dynamics(targets: str = "standardised") -> Dynamics:
    g = seeded()
    normaliser = Normaliser(
        *(torch.randn(S + A, generator=g), 0.1 + torch.rand(S + A, generator=g)),
        *(0.1 * torch.randn(S, generator=g), 0.1 + torch.rand(S, generator=g)),
    )
    config = ModelConfig(members=B, hidden=HIDDEN, targets=targets)
    return Dynamics.create(config, normaliser, RAW, g)


def pool() -> MaskPool:
    return MaskPool.draw(B, 4, HIDDEN, 0.3, seeded(1))


def states(rows: int) -> torch.Tensor:
    state = torch.randn(B * M, rows, S, generator=seeded(2))
    state[..., QUATERNION] /= state[..., QUATERNION].norm(dim=-1, keepdim=True)
    return state


def reference(model: Dynamics, state: torch.Tensor, action: torch.Tensor):
    """Mean and variance of the next state of each particle, by the model itself: (P, N, S)."""
    masks = pool().particles(M)
    parts = []
    for m in range(M):
        of_members = state.reshape(B, M, *state.shape[1:])[:, m].expand(-1, len(action), -1)
        rows = [layer[:, m, None] for layer in masks]
        parts.append(model.predict(of_members, action.expand(B, -1, -1), rows))
    mean = torch.stack([part.next_state_mean for part in parts], 1).flatten(0, 1)
    return mean.detach(), torch.stack([part.variance for part in parts], 1).flatten(0, 1).detach()


@pytest.mark.parametrize("targets", ["raw", "standardised"])
@pytest.mark.parametrize("rows", [1, N], ids=["shared state", "states apart"])
def test_a_step_equals_the_model(targets, rows):
    model, state, action = dynamics(targets), states(rows), torch.randn(N, A, generator=seeded(3))
    with torch.no_grad():
        stepped = particles(model, pool(), B, M).step(state, action)
    torch.testing.assert_close(stepped, reference(model, state, action)[0], atol=2e-5, rtol=1e-5)


def test_a_model_without_dropout_has_a_particle_per_member():
    model = particles(dynamics(), None, 2, M)
    assert model.particles == 2
    full = Dynamics.predict(dynamics(), states(N)[:B], torch.zeros(B, N, A)).next_state_mean
    with torch.no_grad():
        torch.testing.assert_close(
            model.step(states(N)[:2], torch.zeros(N, A)), full[:2], atol=2e-5, rtol=1e-5
        )


@pytest.mark.parametrize("rows", [1, N], ids=["shared state", "states apart"])
def test_gradients_equal_those_of_the_model(rows):
    model, state, action = dynamics(), states(rows), torch.randn(N, A, generator=seeded(3))
    weight = torch.randn(B * M, N, S, generator=seeded(4))
    gradients = []
    for stepped in (particles(model, pool(), B, M).step, lambda s, a: _differentiable(model, s, a)):
        leaves = (state.clone().requires_grad_(), action.clone().requires_grad_())
        gradients.append(torch.autograd.grad((stepped(*leaves) * weight).sum(), leaves))
    for fast, slow in zip(*gradients, strict=True):
        torch.testing.assert_close(fast, slow, atol=1e-4, rtol=1e-4)


def _differentiable(model: Dynamics, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    masks = [layer.flatten(0, 1)[:, None] for layer in pool().particles(M)]
    repeated = particles_of(model)
    return repeated.predict(
        state.expand(-1, len(action), -1), action.expand(B * M, -1, -1), masks
    ).next_state_mean


def particles_of(model: Dynamics) -> Dynamics:
    """The model with each member written down M times."""
    wide = dynamics_of_members(B * M)
    with torch.no_grad():
        for to, of in zip(wide.ensemble.parameters(), model.ensemble.parameters(), strict=True):
            to.copy_(of if of.ndim == 1 else of.repeat_interleave(M, 0))
    return wide


def dynamics_of_members(members: int) -> Dynamics:
    small = dynamics()
    config = ModelConfig(members=members, hidden=HIDDEN, targets="standardised")
    return Dynamics.create(config, small.normaliser, RAW, seeded())


def test_sampled_steps_have_the_predicted_spread():
    # Without a quaternion, so that renormalising does not change the spread.
    base = dynamics()
    model = Dynamics(base.ensemble, base.normaliser, RawCoordinates(S, A), base.standardised_targets)
    state, action = states(1), torch.zeros(20000, A)
    with torch.no_grad():
        drawn = particles(model, pool(), B, M, sampled=True).step(state, action, seeded(5))
    mean, variance = reference(model, state, action[:1])
    torch.testing.assert_close(drawn.mean(1, keepdim=True), mean, atol=0.03, rtol=0.0)
    torch.testing.assert_close(drawn.var(1, keepdim=True), variance, atol=0.01, rtol=0.05)


def test_what_cannot_be_built_is_refused():
    with pytest.raises(ValueError, match="4 members"):
        particles(dynamics(), None, 4, 1)
    with pytest.raises(ValueError, match="5 particles"):
        particles(dynamics(), pool(), B, 5)
    with pytest.raises(ValueError, match="variance head"):
        particles(dynamics(), None, B, 1).step(states(1)[:B], torch.zeros(2, A), seeded())


@pytest.mark.parametrize("rows", [1, 4], ids=["shared state", "states apart"])
def test_steps_and_gradients_in_object_coordinates_equal_the_model(rows):
    task, g = get_task("egg_rotate"), seeded()
    coordinates = coordinates_of("contact", task)
    widths = (coordinates.inputs, coordinates.changes)
    statistics = (
        part for n in widths for part in (0.1 * torch.randn(n, generator=g), 1 + torch.rand(n, generator=g))
    )
    config = ModelConfig(members=B, hidden=HIDDEN, targets="standardised")
    model = Dynamics.create(config, Normaliser(*statistics), coordinates, g)
    state = 0.1 * torch.randn(B, rows, task.state_dim, generator=g)
    state[..., 54:] += torch.tensor([1.0, 0.87, 0.17, 1.0, 0.0, 0.0, 0.0])
    action = torch.rand(4, task.action_dim, generator=g)
    fast = particles(model, None, B, 1).step
    leaves = state.requires_grad_(), action.requires_grad_()
    results = fast(*leaves), model.predict(state.expand(-1, 4, -1), action.expand(B, -1, -1)).next_state_mean
    torch.testing.assert_close(*results, atol=2e-4, rtol=1e-4)
    with torch.no_grad():
        torch.testing.assert_close(fast(state, action), results[0], atol=1e-5, rtol=1e-5)
    gradients = [torch.autograd.grad(result.square().sum(), leaves) for result in results]
    for ours, autograds in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, autograds, atol=2e-2, rtol=1e-3)

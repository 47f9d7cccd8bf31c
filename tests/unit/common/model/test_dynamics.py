"""Prediction in state units, quaternions of norm 1, and gradients that reach the action."""

import pytest
import torch

from common.model.config import ModelConfig
from common.model.coordinates import RawCoordinates
from common.model.dynamics import Dynamics
from common.model.normaliser import Normaliser

S, A, QUATERNION = 6, 2, slice(2, 6)


def normaliser():
    return Normaliser(
        input_mean=torch.tensor([*range(6), 0.5, -0.5]),
        input_std=torch.tensor([*range(1, 7), 2.0, 4.0]),
        delta_mean=torch.full((6,), 0.1),
        delta_std=torch.arange(1.0, 7.0) / 10,
    )


def model(targets="raw", quaternions=(QUATERNION,)):
    config = ModelConfig(members=2, hidden=(16,), targets=targets)
    coordinates = RawCoordinates(S, A, quaternions)
    return Dynamics.create(config, normaliser(), coordinates, torch.Generator().manual_seed(0))


def inputs():
    generator = torch.Generator().manual_seed(1)
    state = torch.randn(2, 5, S, generator=generator)
    return state, torch.randn(2, 5, A, generator=generator)


def test_encoding_is_equation_3():
    state, action = inputs()
    x = model().encode(state, action)
    expected = (torch.cat((state, action), -1) - normaliser().input_mean) / normaliser().input_std
    torch.testing.assert_close(x, expected)


def test_raw_targets_add_the_mean_to_the_state():
    state, action = inputs()
    prediction = model(quaternions=()).predict(state, action)
    assert torch.equal(prediction.next_state_mean, state + prediction.target_mean)
    assert torch.equal(prediction.variance, prediction.target_log_var.exp())


def test_standardised_targets_are_scaled_back():
    state, action = inputs()
    dynamics = model("standardised", quaternions=())
    prediction = dynamics.predict(state, action)
    scale = normaliser().delta_std
    expected = state + prediction.target_mean * scale + 0.1
    torch.testing.assert_close(prediction.next_state_mean, expected)
    torch.testing.assert_close(prediction.variance, prediction.target_log_var.exp() * scale**2)
    back = dynamics.target(state, prediction.next_state_mean)
    torch.testing.assert_close(back, prediction.target_mean, atol=1e-4, rtol=1e-4)


def test_predicted_quaternions_have_norm_one_and_the_rest_is_untouched():
    state, action = inputs()
    with_norm = model().predict(state, action)
    without = model(quaternions=()).predict(state, action)
    norms = with_norm.next_state_mean[..., QUATERNION].norm(dim=-1)
    torch.testing.assert_close(norms, torch.ones(2, 5))
    assert torch.equal(with_norm.next_state_mean[..., :2], without.next_state_mean[..., :2])


def test_a_zero_quaternion_gives_finite_values_and_gradients():
    state = torch.zeros(1, 1, S, requires_grad=True)
    result = model().coordinates.moved(state, torch.zeros(S))
    result.sum().backward()
    assert torch.equal(result, torch.zeros(1, 1, S))
    assert torch.isfinite(state.grad).all()


def test_the_target_of_a_quaternion_ignores_its_sign():
    state, _ = inputs()
    flipped = state.clone()
    flipped[..., QUATERNION] *= -1
    assert torch.equal(model().target(state, flipped), torch.zeros(2, 5, S))


@pytest.mark.parametrize("targets", ["raw", "standardised"])
def test_gradient_of_the_action_matches_finite_differences(targets):
    state, action = inputs()
    dynamics = model(targets)
    dynamics.ensemble.double()
    doubles = {name: tensor.double() for name, tensor in dynamics.normaliser.tensors().items()}
    exact = Dynamics(
        dynamics.ensemble, Normaliser(**doubles), dynamics.coordinates, dynamics.standardised_targets
    )
    wanted = action.double().requires_grad_()

    def predicted(a):
        return exact.predict(state.double(), a).next_state_mean

    assert torch.autograd.gradcheck(predicted, (wanted,))

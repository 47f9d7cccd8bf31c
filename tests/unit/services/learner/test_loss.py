"""Each term of Eq. (4) against loops in float64 that share no code with it."""

import math

import numpy as np
import pytest
import torch

from common.model.config import ModelConfig
from common.model.coordinates import RawCoordinates
from common.model.dynamics import Dynamics
from common.model.masks import MaskPool
from common.model.normaliser import Normaliser
from services.learner.backprop import TrainedEnsemble
from services.learner.config import LossConfig
from services.learner.loss import loss_terms, weight_decay
from services.learner.replay import Windows

B, N, S, A = 2, 4, 3, 2
DECAY = (0.1, 0.2, 0.3)
MODEL = ModelConfig(members=B, hidden=(6, 5), dropout=0.3)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def softplus(x):
    return np.log1p(np.exp(x))


class Case:
    """A small model, windows and masks, and the same in float64."""

    def __init__(self, targets="raw"):
        generator = torch.Generator().manual_seed(0)

        def rand(*shape):
            return torch.randn(shape, generator=generator)

        normaliser = Normaliser(rand(S + A), rand(S + A).exp(), rand(S), rand(S).exp())
        config = MODEL.model_copy(update={"targets": targets})
        self.dynamics = Dynamics.create(config, normaliser, RawCoordinates(S, A), generator)
        with torch.no_grad():
            for bias in self.dynamics.ensemble.biases:
                bias.copy_(rand(*bias.shape))
        pool = MaskPool.draw(B, 3, MODEL.hidden, 0.3, generator)
        self.masks = (pool.pick(N, generator), pool.pick(N, generator))
        self.windows = Windows(rand(B, N, S), rand(B, N, A), rand(B, N, S), rand(B, N, A), rand(B, N, S))

    def head(self, b, state, action, masks, n):
        """Mean and log-variance (S,) of one row of one member."""
        stats = {k: v.double().numpy() for k, v in self.dynamics.normaliser.tensors().items()}
        ensemble = self.dynamics.ensemble
        h = (np.concatenate((state, action)) - stats["input_mean"]) / stats["input_std"]
        for layer in range(2):
            z = self.layer(ensemble, layer, b, h)
            h = z * sigmoid(z) * masks[layer][b, n].double().numpy()
        out = self.layer(ensemble, 2, b, h)
        high, low = (x.detach().double().numpy() for x in (ensemble.max_log_var, ensemble.min_log_var))
        return out[:S], low + softplus(high - softplus(high - out[S:]) - low)

    @staticmethod
    def layer(ensemble, layer, b, h):
        weight = ensemble.weights[layer][b].detach().double().numpy()
        return h @ weight + ensemble.biases[layer][b, 0].detach().double().numpy()

    def limited(self, change, deviations, scale, shift):
        middle = self.dynamics.normaliser.delta_mean.double().numpy()
        reach = deviations * self.dynamics.normaliser.delta_std.double().numpy()
        return (np.clip(change, middle - reach, middle + reach) - shift) / scale

    def expected(self, options, weights=None):
        """first, second, penalty: loops over members, windows and dimensions."""
        weights = np.ones(S) if weights is None else weights
        stats = {k: v.double().numpy() for k, v in self.dynamics.normaliser.tensors().items()}
        standard = self.dynamics.standardised_targets
        scale, shift = (stats["delta_std"], stats["delta_mean"]) if standard else (np.ones(S), np.zeros(S))
        totals = np.zeros(3)
        for b in range(B):
            for n in range(N):
                s0, a0, s1, a1, s2 = (part[b, n].double().numpy() for part in self.windows)
                state = s0
                for step, (action, target) in enumerate(((a0, s1), (a1, s2))):
                    mean, log_var = self.head(b, state, action, self.masks[step], n)
                    wanted = (target - state - shift) / scale
                    if options.target_bound > 0:
                        wanted = self.limited(target - state, options.target_bound, scale, shift)
                    for d in range(S):
                        error = (mean[d] - wanted[d]) ** 2 / math.exp(log_var[d]) + log_var[d]
                        error *= math.exp(options.beta_nll * log_var[d])
                        totals[step] += weights[d] * error / (N * S)
                        variance = math.exp(log_var[d]) * scale[d] ** 2
                        if options.penalty_units == "standardised":
                            variance /= stats["delta_std"][d] ** 2
                        totals[2] += options.variance_penalty * weights[d] * variance / (N * S)
                    state = s1 if options.teacher_forcing else state + mean * scale + shift
        return totals


@pytest.mark.parametrize("targets", ["raw", "standardised"])
@pytest.mark.parametrize(
    "options",
    [
        LossConfig(decay=DECAY),
        LossConfig(decay=DECAY, teacher_forcing=True),
        LossConfig(decay=DECAY, penalty_units="standardised", variance_penalty=2.0),
        LossConfig(decay=DECAY, beta_nll=0.5),
        LossConfig(decay=DECAY, target_bound=0.4),
    ],
)
def test_data_terms_equal_explicit_loops(options, targets):
    case = Case(targets)
    terms = loss_terms(case.dynamics, case.windows, case.masks, options)
    np.testing.assert_allclose(torch.stack(terms[:3]).detach().numpy(), case.expected(options), rtol=2e-5)


def test_dimension_weights_weigh_errors_and_penalty():
    case, options = Case(), LossConfig(decay=DECAY)
    weights = torch.tensor([0.2, 3.0, 1.0])
    terms = loss_terms(case.dynamics, case.windows, case.masks, options, weights)
    expected = case.expected(options, weights.double().numpy())
    np.testing.assert_allclose(torch.stack(terms[:3]).detach().numpy(), expected, rtol=2e-5)


def test_one_step_loss_has_no_second_term():
    case = Case()
    both = loss_terms(case.dynamics, case.windows, case.masks, LossConfig(decay=DECAY))
    one = loss_terms(case.dynamics, case.windows, case.masks, LossConfig(decay=DECAY, second_step=False))
    assert one.second_step == 0.0
    assert one.first_step == both.first_step
    assert one.variance_penalty < both.variance_penalty


def test_the_second_step_trains_the_first_unless_teacher_forced():
    def gradient_of_first_mask_rows(teacher_forcing):
        case = Case()
        options = LossConfig(decay=DECAY, teacher_forcing=teacher_forcing)
        state = case.windows.state.clone().requires_grad_()
        windows = case.windows._replace(state=state)
        loss_terms(case.dynamics, windows, case.masks, options).second_step.backward()
        return state.grad

    assert gradient_of_first_mask_rows(False).abs().min() > 0
    assert gradient_of_first_mask_rows(True) is None


@pytest.mark.parametrize("biases", [True, False])
def test_weight_decay_is_the_sum_of_squares(biases):
    ensemble = Case().dynamics.ensemble
    expected = 0.0
    for rate, weight, bias in zip(DECAY, ensemble.weights, ensemble.biases, strict=True):
        numbers = [*weight.flatten().tolist(), *(bias.flatten().tolist() if biases else [])]
        expected += rate * sum(number**2 for number in numbers)
    assert weight_decay(ensemble, DECAY, biases) == pytest.approx(expected, rel=1e-5)


def test_bound_loss_is_the_summed_gap():
    case = Case()
    terms = loss_terms(case.dynamics, case.windows, case.masks, LossConfig(decay=DECAY, bound_weight=0.25))
    assert float(terms.bound.detach()) == pytest.approx(0.25 * S * 10.5)


@pytest.mark.parametrize("second_step", [True, False])
@pytest.mark.parametrize("masked", [True, False])
def test_written_out_gradient_equals_autograd(masked, second_step):
    case, options = Case("standardised"), LossConfig(decay=DECAY, second_step=second_step)
    masks = case.masks if masked else (None, None)
    plain = case.dynamics.ensemble
    loss_terms(case.dynamics, case.windows, masks, options).total.backward()
    ensemble = TrainedEnsemble.like(plain)
    dynamics = Dynamics(ensemble, case.dynamics.normaliser, case.dynamics.coordinates, True)
    for _ in range(2):  # the second time, the gradients of the first must be gone
        ensemble.start_gradient()
        loss_terms(dynamics, case.windows, masks, options).total.backward()
    for fast, slow in zip(ensemble.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(fast.grad, slow.grad, rtol=2e-5, atol=2e-6)

"""The loss of Eq. (4), a function per term; every term is summed over the members.

Letters: B members, N windows, D numbers of a change. Reduction: mean over N and D, sum over B, in the
variance penalty as in the likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from common.model.dynamics import Dynamics, Prediction
from common.model.ensemble import Ensemble
from services.learner.config import LossConfig
from services.learner.replay import Windows

Masks = Sequence[Tensor] | None


class LossTerms(NamedTuple):
    """The terms of Eq. (4) that rest on data, and the pull on the log-variance bounds; scalars."""

    first_step: Tensor
    second_step: Tensor
    variance_penalty: Tensor
    bound: Tensor

    @property
    def total(self) -> Tensor:
        return self.first_step + self.second_step + self.variance_penalty + self.bound


def loss_terms(
    dynamics: Dynamics,
    windows: Windows,
    masks: tuple[Masks, Masks],
    options: LossConfig,
    weights: Tensor | None = None,
) -> LossTerms:
    """The terms of Eq. (4) but for weight decay.

    `masks` act in step 1 and in step 2; `weights` (D,), default 1, weigh its numbers.
    """
    first = dynamics.predict(windows.state, windows.action, masks[0])
    first_target = dynamics.target(windows.state, windows.next_state)
    first_target = bounded(dynamics, first_target, options.target_bound)
    first_step = nll(first, first_target, options.beta_nll, weights)
    penalty = variance_penalty(dynamics, first, options, weights)
    second_step = first_step.new_zeros(())
    if options.second_step:
        second, second_target = second_prediction(dynamics, first, windows, masks[1], options)
        second_target = bounded(dynamics, second_target, options.target_bound)
        second_step = nll(second, second_target, options.beta_nll, weights)
        penalty = penalty + variance_penalty(dynamics, second, options, weights)
    bound = bound_loss(dynamics.ensemble, options.bound_weight)
    return LossTerms(first_step, second_step, penalty, bound)


def second_prediction(
    dynamics: Dynamics, first: Prediction, windows: Windows, masks: Masks, options: LossConfig
) -> tuple[Prediction, Tensor]:
    """Step 2 and its target (B, N, D): the change that leads from its input to the true s_{t+2}."""
    # Paper: Eq. (4) prints the true s_{t+1} as input, yet calls the loss DPETS's, which feeds the model's own
    # prediction and lets the gradient through.
    state = windows.next_state if options.teacher_forcing else first.next_state_mean
    prediction = dynamics.predict(state, windows.next_action, masks)
    return prediction, dynamics.target(state, windows.last_state)


def bounded(dynamics: Dynamics, target: Tensor, deviations: float) -> Tensor:
    """Targets (B, N, D), none further than so many `deviations` from the mean change; 0: as they are."""
    if deviations <= 0.0:
        return target
    if dynamics.standardised_targets:
        return target.clamp(-deviations, deviations)
    normaliser = dynamics.normaliser
    reach = deviations * normaliser.delta_std
    return torch.minimum(torch.maximum(target, normaliser.delta_mean - reach), normaliser.delta_mean + reach)


def nll(prediction: Prediction, target: Tensor, beta: float = 0.0, weights: Tensor | None = None) -> Tensor:
    """E' Sigma^-1 E + log det Sigma for a diagonal Sigma, Eq. (4), terms 1 and 2; target (B, N, D).

    With `beta` each dimension's error counts in proportion to its variance**beta, held constant.
    """
    log_var = prediction.target_log_var
    error = (prediction.target_mean - target).square() * torch.exp(-log_var) + log_var
    if beta > 0.0:
        error = error * torch.exp(beta * log_var.detach())
    return _reduce(error, weights)


def variance_penalty(
    dynamics: Dynamics, prediction: Prediction, options: LossConfig, weights: Tensor | None = None
) -> Tensor:
    """Delta tr Sigma of one step, Eq. (4), term 3, in the units that `penalty_units` names."""
    # Paper: the printed Delta * Sigma is a matrix; read as its trace, reduced like the likelihood.
    variance = prediction.variance
    if options.penalty_units == "standardised":
        variance = variance / dynamics.normaliser.delta_std.square()
    return options.variance_penalty * _reduce(variance, weights)


@torch.no_grad()
def weight_decay(ensemble: Ensemble, decay: Sequence[float], biases: bool) -> float:
    """Sum over layers of lambda_l ||W_l||^2, with the biases counted into W_l or not, Eq. (4), term 4.

    A value to report: the optimiser adds its gradient, 2 lambda_l W_l.
    """
    total = 0.0
    for rate, weight, bias in zip(decay, ensemble.weights, ensemble.biases, strict=True):
        total += rate * float(torch.dot(weight.flatten(), weight.flatten()))
        if biases:
            total += rate * float(bias.square().sum())
    return total


def bound_loss(ensemble: Ensemble, weight: float) -> Tensor:
    """Pull the learned bounds of the log-variance together: weight * sum(max - min)."""
    return weight * (ensemble.max_log_var - ensemble.min_log_var).sum()


def _reduce(values: Tensor, weights: Tensor | None) -> Tensor:
    """(B, N, D) → scalar: mean over N and D, each dimension weighed, sum over B."""
    if weights is not None:
        values = values * weights
    _, N, D = values.shape
    return values.sum() * (1.0 / (N * D))

"""The dynamics model: normaliser, ensemble and state change together, Eq. (1) and Eq. (3).

Letters: B members, N rows, I input features, S state, A action.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from common.geometry import normalise
from common.model.config import ModelConfig
from common.model.ensemble import Ensemble
from common.model.normaliser import Normaliser


class Prediction(NamedTuple):
    """One step of every member; (B, N, S) each, in the state's units unless said otherwise."""

    next_state_mean: Tensor
    variance: Tensor  # of the state change, squared units
    target_mean: Tensor  # mean of the state change in the unit of the targets (raw or standardised)
    target_log_var: Tensor  # its log-variance in that unit, squared


@dataclass(frozen=True)
class Dynamics:
    """Predicts the next state of every member; differentiable in state, action and weights.

    x = [(s - mu_s) / sd_s, (a - mu_a) / sd_a]; [mean, log_var] = ensemble(x); delta = mean (targets raw) or
    mean * sd_delta + mu_delta (standardised); s' = s + delta with each quaternion scaled to norm 1.
    """

    ensemble: Ensemble
    normaliser: Normaliser
    quaternions: tuple[slice, ...]
    standardised_targets: bool

    @staticmethod
    def create(
        config: ModelConfig,
        normaliser: Normaliser,
        quaternions: Sequence[slice],
        generator: torch.Generator,
    ) -> Dynamics:
        """A model with fresh weights for the dimensions of `normaliser`."""
        state_dim, action_dim = len(normaliser.state_mean), len(normaliser.action_mean)
        ensemble = Ensemble.create(config, feature_count(state_dim, action_dim), state_dim, generator)
        return Dynamics(ensemble, normaliser, tuple(quaternions), config.targets == "standardised")

    def encode(self, state: Tensor, action: Tensor) -> Tensor:
        """State (.., S) and action (.., A) → features (.., I). New input features belong here, and only here.

        `feature_count` states their number.
        """
        return torch.cat((self.normaliser.state(state), self.normaliser.action(action)), dim=-1)

    def predict(self, state: Tensor, action: Tensor, masks: Sequence[Tensor] | None = None) -> Prediction:
        """State (B, N, S) and action (B, N, A) → Gaussian over the next state, Eq. (3) before averaging."""
        mean, log_var = self.ensemble(self.encode(state, action), masks)
        delta, variance = mean, torch.exp(log_var)
        if self.standardised_targets:
            delta = mean * self.normaliser.delta_std + self.normaliser.delta_mean
            variance = variance * self.normaliser.delta_std**2
        return Prediction(self.renormalise(state + delta), variance, mean, log_var)

    def target(self, state: Tensor, next_state: Tensor) -> Tensor:
        """The state change from `state` to `next_state`, (.., S) each, in the unit of the targets."""
        delta = self.same_hemisphere(state, next_state) - state
        if self.standardised_targets:
            delta = (delta - self.normaliser.delta_mean) * self.normaliser.delta_std.reciprocal()
        return delta

    def renormalise(self, state: Tensor) -> Tensor:
        """Scale each quaternion of `state` (.., S) to norm 1; one near 0 stays short, never NaN."""
        for part in self.quaternions:
            state = _replace(state, part, normalise(state[..., part]))
        return state

    def to(self, device: torch.device | str) -> Dynamics:
        """The same model on `device`; the ensemble itself moves."""
        return replace(self, ensemble=self.ensemble.to(device), normaliser=self.normaliser.to(device))

    def same_hemisphere(self, state: Tensor, next_state: Tensor) -> Tensor:
        """Write each quaternion of `next_state` as the one of q and -q that is nearer to that of `state`."""
        for part in self.quaternions:
            q = next_state[..., part]
            away = (state[..., part] * q).sum(dim=-1, keepdim=True) < 0
            next_state = _replace(next_state, part, torch.where(away, -q, q))
        return next_state


def feature_count(state_dim: int, action_dim: int) -> int:
    """I, the number of features that `Dynamics.encode` makes."""
    return state_dim + action_dim


def _replace(state: Tensor, part: slice, value: Tensor) -> Tensor:
    return torch.cat((state[..., : part.start], value, state[..., part.stop :]), dim=-1)

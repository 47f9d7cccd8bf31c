"""The dynamics model: normaliser, ensemble and state change together, Eq. (1) and Eq. (3).

Letters: B members, N rows, I input features, S state, A action, D numbers of a change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from common.model.config import ModelConfig
from common.model.coordinates import Coordinates
from common.model.ensemble import Ensemble
from common.model.normaliser import Normaliser


class Prediction(NamedTuple):
    """One step of every member, in the state's units unless said otherwise."""

    next_state_mean: Tensor  # (B, N, S)
    change_mean: Tensor  # (B, N, D)
    variance: Tensor  # of the change (B, N, D), squared units
    target_mean: Tensor  # mean of the change (B, N, D) in the unit of the targets (raw or standardised)
    target_log_var: Tensor  # its log-variance (B, N, D) in that unit, squared


@dataclass(frozen=True)
class Dynamics:
    """Predicts the next state of every member; differentiable in state, action and weights.

    x = (inputs(s, a) - mu) / sd; [mean, log_var] = ensemble(x); delta = mean (targets raw) or
    mean * sd_delta + mu_delta (standardised); s' = s moved by delta. `coordinates` say what inputs and a
    change are; raw, they are [s, a] and a difference.
    """

    ensemble: Ensemble
    normaliser: Normaliser
    coordinates: Coordinates
    standardised_targets: bool

    @staticmethod
    def create(
        config: ModelConfig, normaliser: Normaliser, coordinates: Coordinates, generator: torch.Generator
    ) -> Dynamics:
        """A model with fresh weights for `coordinates`."""
        ensemble = Ensemble.create(config, coordinates.inputs, coordinates.changes, generator)
        return Dynamics(ensemble, normaliser, coordinates, config.targets == "standardised")

    def encode(self, state: Tensor, action: Tensor) -> Tensor:
        """State (.., S) and action (.., A) → standardised features (.., I)."""
        return self.normaliser.standardised(self.coordinates.encode(state, action))

    def predict(self, state: Tensor, action: Tensor, masks: Sequence[Tensor] | None = None) -> Prediction:
        """State (B, N, S) and action (B, N, A) → Gaussian over the change, Eq. (3) before averaging."""
        mean, log_var = self.ensemble(self.encode(state, action), masks)
        delta, variance = mean, torch.exp(log_var)
        if self.standardised_targets:
            delta = mean * self.normaliser.delta_std + self.normaliser.delta_mean
            variance = variance * self.normaliser.delta_std**2
        return Prediction(self.coordinates.moved(state, delta), delta, variance, mean, log_var)

    def target(self, state: Tensor, next_state: Tensor) -> Tensor:
        """The change (.., D) from `state` to `next_state`, (.., S) each, in the unit of the targets."""
        delta = self.coordinates.change(state, next_state)
        if self.standardised_targets:
            delta = (delta - self.normaliser.delta_mean) * self.normaliser.delta_std.reciprocal()
        return delta

    def to(self, device: torch.device | str) -> Dynamics:
        """The same model on `device`; the ensemble itself moves."""
        return replace(
            self,
            ensemble=self.ensemble.to(device),
            normaliser=self.normaliser.to(device),
            coordinates=self.coordinates.to(device),
        )

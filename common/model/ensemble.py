"""The probabilistic ensemble as one batched network: member b of every layer is slice b of one tensor.

Letters: B members, N rows, I input features, S state dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import silu, softplus

from common.model.config import ModelConfig


class Ensemble(nn.Module):
    """B multilayer perceptrons that map features to a Gaussian each, Eq. (1).

    h_0 = x, h_l = silu(h_{l-1} W_l + b_l) * mask_l, and the head gives [mean, raw log-variance].
    `weights[l]` is (B, in_l, out_l), `biases[l]` is (B, 1, out_l); the head has out = 2 S.
    """

    def __init__(
        self, weights: Sequence[Tensor], biases: Sequence[Tensor], max_log_var: Tensor, min_log_var: Tensor
    ) -> None:
        super().__init__()
        self.state_dim = len(max_log_var)
        self.weights = nn.ParameterList([nn.Parameter(weight) for weight in weights])
        self.biases = nn.ParameterList([nn.Parameter(bias) for bias in biases])
        self.max_log_var = nn.Parameter(max_log_var)
        self.min_log_var = nn.Parameter(min_log_var)

    @staticmethod
    def create(config: ModelConfig, inputs: int, state_dim: int, generator: torch.Generator) -> Ensemble:
        """Fresh weights, zero biases, for I = `inputs` features and S = `state_dim` outputs."""
        sizes = config.layer_sizes(inputs, 2 * state_dim)
        return Ensemble(
            weights=[_initial_weight(config.members, i, o, generator) for i, o in sizes],
            biases=[torch.zeros(config.members, 1, o) for _, o in sizes],
            max_log_var=torch.full((state_dim,), config.log_var_max),
            min_log_var=torch.full((state_dim,), config.log_var_min),
        )

    def forward(self, x: Tensor, masks: Sequence[Tensor] | None = None) -> tuple[Tensor, Tensor]:
        """Features (B, N, I) → mean and log-variance, (B, N, S) each, in the unit of the targets.

        `masks[l]`, broadcastable to (B, N, hidden_l), multiplies hidden layer l; None drops nothing.
        """
        # Paper: no division by 1 - p, as in DPETS: the same masks act in training and in planning.
        h = x
        for layer, (weight, bias) in enumerate(zip(self.weights[:-1], self.biases[:-1], strict=True)):
            h = silu(torch.baddbmm(bias, h, weight))
            if masks is not None:
                h = h.mul_(masks[layer])  # in place: silu's gradient does not need its result
        out = torch.baddbmm(self.biases[-1], h, self.weights[-1])
        mean, raw_log_var = torch.split(out, self.state_dim, dim=-1)
        return mean, self.clamp(raw_log_var)

    def clamp(self, raw_log_var: Tensor) -> Tensor:
        """Bound the log-variance softly between learned limits that all members share."""
        below = self.max_log_var - softplus(self.max_log_var - raw_log_var)
        return self.min_log_var + softplus(below - self.min_log_var)


def _initial_weight(members: int, fan_in: int, fan_out: int, generator: torch.Generator) -> Tensor:
    """Truncated normal with deviation 1 / (2 sqrt(fan_in)), cut at two deviations, (B, in, out)."""
    deviation = 0.5 / fan_in**0.5
    weight = torch.empty(members, fan_in, fan_out)
    return nn.init.trunc_normal_(
        weight, std=deviation, a=-2 * deviation, b=2 * deviation, generator=generator
    )

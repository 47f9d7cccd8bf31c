"""Rolling the model: the committed actions to ŝ_{k+x}, and candidates from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from services.planner.particles import ParticleModel

Propagation = Literal["particles", "average", "sampled"]


@dataclass(frozen=True)
class Rollout:
    """How P particles move through a model; each keeps its network and mask for the whole horizon.

    `particles`: they stay apart and follow the means. `average`: all are set to their mean after each step,
    Eq. (1) and (3) as printed. `sampled`: they stay apart and draw from the predicted Gaussian.
    """

    # Paper: Eq. (1) and (3) average at every step; that blurs the outcomes of a contact, so particles stay
    # apart by default and only their returns are averaged, as in DPETS.

    model: ParticleModel
    propagation: Propagation = "particles"

    def prefix(self, state: Tensor, committed: Tensor, noise: torch.Generator | None = None) -> Tensor:
        """States (x + 1, P, 1, S) from s_k (S,) through the committed actions (x, A), Sec. III-B."""
        start = state.expand(self.model.particles, 1, -1)
        if len(committed) == 0:
            return start[None]
        return torch.cat((start[None], self.candidates(start, committed[None], noise)))

    def candidates(self, start: Tensor, actions: Tensor, noise: torch.Generator | None = None) -> Tensor:
        """States ŝ_1..ŝ_H (H, P, N, S) for actions (N, H, A) from a shared start (P, 1, S)."""
        states: list[Tensor] = []
        state = start
        for action in actions.unbind(1):
            state = self.model.step(state, action, noise if self.propagation == "sampled" else None)
            if self.propagation == "average":
                state = state.mean(0, keepdim=True).expand_as(state)
            states.append(state)
        return torch.stack(states)


def mean_and_std(states: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (H, S) over particles of one candidate's states (H, P, 1, S)."""
    apart = states[:, :, 0]
    return apart.mean(1), apart.std(1, correction=0)

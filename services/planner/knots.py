"""Action sequences from few free actions: K knots spread over a horizon of H steps."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

Interpolation = Literal["linear", "hold"]


class Knots:
    """Linear map from knots (..., K, A) to sequences (..., H, A), and the way back by sampling.

    `linear`: knot j lies at step j·(H-1)/(K-1), straight lines between. `hold`: each knot lasts H/K steps.
    K = 1 is a constant action; K = 0 or K ≥ H means a free action at each step.
    """

    def __init__(
        self, knots: int, horizon: int, kind: Interpolation, device: str | torch.device = "cpu"
    ) -> None:
        self.horizon = horizon
        self.count = horizon if knots == 0 else min(knots, horizon)
        self.free = self.count == horizon
        steps = torch.arange(horizon, dtype=torch.float64)
        weights = _hold(steps, self.count) if kind == "hold" else _linear(steps, self.count)
        self._weights = weights.to(device, torch.float32)
        self._steps = _knot_steps(self.count, horizon, kind).to(device)

    def expand(self, knots: Tensor) -> Tensor:
        """(..., K, A) -> (..., H, A); stays within the bounds of the knots."""
        return knots if self.free else self._weights @ knots

    def sample(self, actions: Tensor) -> Tensor:
        """Sequences (..., H, A) -> values at the knots (..., K, A)."""
        return actions if self.free else actions[..., self._steps, :]


def shift(actions: Tensor, steps: int, horizon: int, tail: Literal["zero", "repeat"]) -> Tensor:
    """Sequences (E, H, A) as seen `steps` later, (E, horizon, A), filled up with zeros or the last action."""
    left = actions[:, steps : steps + horizon]
    missing = horizon - left.shape[1]
    last = torch.zeros_like(actions[:, -1:]) if tail == "zero" else actions[:, -1:]
    return torch.cat((left, last.expand(-1, missing, -1)), dim=1)


def _linear(steps: Tensor, K: int) -> Tensor:
    """Hat functions (H, K)."""
    if K == 1:
        return torch.ones(len(steps), 1, dtype=steps.dtype)
    position = steps * (K - 1) / (len(steps) - 1)
    return (1 - (position[:, None] - torch.arange(K)).abs()).clamp(min=0)


def _hold(steps: Tensor, K: int) -> Tensor:
    """One-hot rows (H, K)."""
    segment = (steps * K / len(steps)).floor().long()
    return torch.nn.functional.one_hot(segment, K).to(steps.dtype)


def _knot_steps(K: int, H: int, kind: Interpolation) -> Tensor:
    """The step (K,) at which each knot's value stands: the nearest one, or a segment's first."""
    knots = torch.arange(K, dtype=torch.float64)
    if kind == "hold":
        return (knots * H / K).ceil().long()
    return (knots * (H - 1) / max(K - 1, 1)).round().long()

"""What the networks of a compared method see: state and goal in one vector, standardised."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from common.task import Task

# OpenAI's DDPG + HER normalises alike: deviations of at least 0.01, values cut at 5 of them
# (openai/baselines, her/normalizer.py and config.py).
_LEAST_DEVIATION = 0.01
_CLIP = 5.0


class Inputs(nn.Module):
    """(state, goal) → (…, S + G) in deviations of the data that `fit` saw; before that, in their own units.

    The goal is measured with the deviations of what was achieved, so that a goal that is attained looks like
    the part of the state that attains it.
    """

    mean: Tensor
    deviation: Tensor
    fitted: Tensor

    def __init__(self, task: Task) -> None:
        super().__init__()
        self._task = task
        self.width = task.state_dim + task.goal_dim
        self.register_buffer("mean", torch.zeros(self.width))
        self.register_buffer("deviation", torch.ones(self.width))
        self.register_buffer("fitted", torch.tensor(False))

    def fit(self, states: Tensor) -> None:
        """Take mean and deviation from states (N, S); every call after the first changes nothing."""
        if bool(self.fitted):
            return
        mean, deviation = states.mean(0), states.std(0, unbiased=False).clamp_min(_LEAST_DEVIATION)
        self.mean.copy_(torch.cat((mean, self._task.achieved(mean))))
        self.deviation.copy_(torch.cat((deviation, self._task.achieved(deviation))))
        self.fitted.fill_(True)

    def forward(self, state: Tensor, goal: Tensor) -> Tensor:
        """(…, S) and (…, G) → (…, S + G)."""
        raw = torch.cat((state, goal), dim=-1)
        return ((raw - self.mean) / self.deviation).clamp(-_CLIP, _CLIP)

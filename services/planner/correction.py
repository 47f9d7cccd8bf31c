"""Offset-free prediction: what the model has lately been wrong by is added to what it predicts.

A hand that holds still where the model expects it to creep is never brought closer to its goal by replanning:
each plan leaves the same rest. An estimate of the error, as in offset-free MPC (Pannocchia and Rawlings,
"Disturbance models for offset-free model-predictive control", AIChE Journal 49, 2003), takes it away.
It learns from slow steps alone, since what is missed in fast ones does not last, and each step counts for
little, so that the estimate does not wind up where something is in the hand's way.
Letters: P particles, D numbers of a change, S state, A action, T steps.
"""

from __future__ import annotations

import torch
from torch import Tensor

from services.planner.particles import Particles


class Correction:
    """Estimate of each particle's error (P, 1, D): after every executed step a share of what was missed.

    `most` (D,) is the error that a step counts for at most, 0 where nothing is corrected. A step is slow if
    its change, in multiples of `most`, has a root mean square of at most `slow`.
    """

    def __init__(self, share: float, most: Tensor, slow: float) -> None:
        self._share, self._most, self._slow = share, most, slow
        self._chosen = most > 0.0
        self._offset: Tensor | None = None

    def reset(self) -> None:
        """Forget: another episode, or another model."""
        self._offset = None

    def observe(self, model: Particles, states: Tensor, actions: Tensor) -> None:
        """Learn from executed steps: states (T + 1, S) and actions (T, A), oldest first."""
        for before, action, after in zip(states, actions, states[1:], strict=False):
            change, predicted = model.compared(before, action, after)
            pace = (change / self._most)[self._chosen].square().mean().sqrt()
            error = (change - predicted).clamp(-self._most, self._most)
            if not torch.isfinite(error).all():
                continue
            if pace > self._slow:
                error = torch.zeros_like(error)
            offset = torch.zeros_like(error) if self._offset is None else self._offset
            self._offset = offset + self._share * (error - offset)

    def of(self, model: Particles) -> Particles:
        """`model` with the estimate added to every change that it predicts."""
        return model if self._offset is None else model.corrected(self._offset)

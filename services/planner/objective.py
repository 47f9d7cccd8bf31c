"""What a plan maximises, Eq. (5): reward minus a price on state changes, averaged over particles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from common.task import Task
from services.planner.config import PlannerConfig

# A further term: predicted states (H, P, N, S) → its share of the return (P, N).
Term = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Objective:
    """J = mean_p[ Σ_{h=1..H} R(ŝ_h) + T R(ŝ_H) - λ Σ_{h=0..H-1} ‖ŝ_{h+1} - ŝ_h‖₁ + terms ] - w · std_p[same].

    H horizon, P particles, N candidates, S state, G goal. ŝ_0 is where the candidates start.
    """

    # Paper: Eq. (5) adds the smoothing term to a maximised sum, which would reward jumps; here it is
    # subtracted (a negative `smooth_weight` is the printed sign), and it acts on `smooth_slices` alone.
    # Paper: Eq. (1) sums R(s_t .. s_{t+H-1}), whose first term no action changes; here ŝ_{t+1} .. ŝ_{t+H}.

    reward: Callable[[Tensor, Tensor], Tensor]
    distances: Callable[[Tensor, Tensor], Sequence[Tensor]]
    plausible: Callable[[Tensor], Tensor]
    smooth_slices: tuple[slice, ...] = ()
    smooth_weight: float = 0.0
    disagreement_weight: float = 0.0
    terms: tuple[Term, ...] = ()
    # Paper: H reaches to the episode's end. A shorter one prefers what is near now to what leads further;
    # T steps in which nothing changes after ŝ_H stand for the rest.
    tail_steps: float = 0.0

    @staticmethod
    def create(task: Task, config: PlannerConfig, terms: tuple[Term, ...] = ()) -> Objective:
        """The objective of `task` with the weights of `config`, and further `terms`."""
        slices = tuple(group.slice for group in task.groups if group.name in config.smooth_groups)
        sign = 1.0 if config.smooth_sign == "subtract" else -1.0
        return Objective(
            task.reward,
            task.residuals,
            task.plausible,
            slices,
            sign * config.smooth_weight,
            config.disagreement_weight,
            (*_hold_terms(task, config), *terms),
            config.tail_steps,
        )

    def until(self, steps_left: int) -> Objective:
        """The same for a horizon that ends so many steps before the episode: the tail ends with it."""
        return replace(self, tail_steps=min(self.tail_steps, max(0.0, float(steps_left))))

    def __call__(self, start: Tensor, states: Tensor, goal: Tensor) -> Tensor:
        """Scores (N,) of predicted states (H, P, N, S) from start (P, 1, S) or (P, N, S) for goal (G,).

        A candidate with an implausible state (non-finite, or out of the task's bounds) scores -inf.
        """
        rewards = self.reward(states, goal)
        returns = rewards.sum(0) + self.tail_steps * rewards[-1] - self._smoothing(start, states)
        for term in self.terms:
            returns = returns + term(states)
        score = returns.mean(0)
        if self.disagreement_weight > 0.0:
            score = score - self.disagreement_weight * returns.std(0, correction=0)
        sound = self.plausible(states.detach()).all(dim=0).all(dim=0)
        return torch.where(sound, score, -math.inf)

    def residuals(self, start: Tensor, states: Tensor, goal: Tensor) -> tuple[Tensor, ...]:
        """Vectors (..., N, R) whose norms add up to minus P times the mean return.

        Without what has no distance: events, terms, disagreement, and smoothing with the printed sign.
        """
        parts = tuple(self.distances(states, goal))
        if self.tail_steps > 0.0:
            parts = (*parts, *(self.tail_steps * part for part in self.distances(states[-1:], goal)))
        if self.smooth_weight <= 0.0:
            return parts
        jumps = (self.smooth_weight * jump for jump in self._jumps(start, states))
        return (*parts, *(jump.movedim(-1, 0)[..., None] for jump in jumps))

    def _smoothing(self, start: Tensor, states: Tensor) -> Tensor | float:
        """λ Σ_h ‖ŝ_{h+1} - ŝ_h‖₁ over the smoothed dimensions: (P, N)."""
        if self.smooth_weight == 0.0 or not self.smooth_slices:
            return 0.0
        return self.smooth_weight * sum(jump.abs().sum((0, -1)) for jump in self._jumps(start, states))

    def _jumps(self, start: Tensor, states: Tensor) -> list[Tensor]:
        """State changes (H, P, N, D) in each smoothed part of the state."""
        first = start.expand_as(states[0])[None]
        before = torch.cat((first, states[:-1]))
        return [states[..., part] - before[..., part] for part in self.smooth_slices]


def _hold_terms(task: Task, config: PlannerConfig) -> tuple[Term, ...]:
    """Prices on an object that leaves the hand; those of weight 0 are left out."""
    # Paper: not in it. Where only rotation is rewarded, plans roll the object to the palm's edge.
    terms: list[Term] = []
    if config.stray_weight > 0.0:
        terms.append(_price(config.stray_weight, task.straying))
    if config.sink_weight > 0.0:
        terms.append(_price(config.sink_weight, task.sinking))
    return tuple(terms)


def _price(weight: float, distance: Callable[[Tensor], Tensor]) -> Term:
    """States (H, P, N, S) → the share (P, N) of the return that `distance` costs."""
    return lambda states: -weight * distance(states).sum(0)

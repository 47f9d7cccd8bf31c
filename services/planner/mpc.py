"""One plan: state, goal and committed actions in, the next H actions out (Sec. III-B)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from common.task import Task
from services.planner.cem import HIGH, LOW, Found, cem, usable
from services.planner.config import PlannerConfig
from services.planner.gauss_newton import gauss_newton
from services.planner.gradient import refine
from services.planner.icem import icem
from services.planner.knots import Knots, shift
from services.planner.objective import Objective
from services.planner.particles import ParticleModel
from services.planner.rollout import Rollout, mean_and_std


class Predictor(Protocol):
    """What tells where actions lead; shapes as in `Rollout`."""

    def prefix(self, state: Tensor, committed: Tensor, noise: torch.Generator | None = None) -> Tensor: ...

    def candidates(self, start: Tensor, actions: Tensor, noise: torch.Generator | None = None) -> Tensor: ...


@dataclass(frozen=True)
class Plan:
    """Actions (H, A) for steps k + x .. k + x + H - 1, in [-1, 1], and what the model expects of them.

    `predicted_mean`, `predicted_std` (x + H, S): states ŝ_{k+1} .. ŝ_{k+x+H}, over particles, raw units.
    `score`: Eq. (5). `valid` is False when every candidate diverged; the actions are then the warm start.
    """

    actions: Tensor
    score: float
    predicted_mean: Tensor
    predicted_std: Tensor
    valid: bool


@dataclass(frozen=True)
class _Memory:
    """What one plan leaves for the next: sequences (E, H, A), the executed one first."""

    goal: Tensor
    start_left: int  # steps from the plan's first action to the episode's end
    sequences: Tensor


@dataclass(frozen=True)
class _Scored:
    """A candidate (K, A) with its score and predicted states (H, P, 1, S)."""

    score: float
    knots: Tensor
    states: Tensor


@dataclass
class _Problem:
    """What one plan optimises: knots (N, K, A) from start (P, 1, S) towards goal (G,).

    `best` is the best candidate yet scored, kept so that the answer need not be rolled out again.
    """

    rollout: Predictor
    objective: Objective
    knots: Knots
    start: Tensor
    goal: Tensor
    noise: torch.Generator
    best: _Scored | None = None

    def score(self, knots: Tensor) -> Tensor:
        """Scores (N,)."""
        return self._scores(knots, self._states(knots))

    def score_and_gradient(self, knots: Tensor) -> tuple[Tensor, Tensor]:
        """Scores (N,) and their gradients (N, K, A)."""
        with torch.enable_grad():
            leaf = knots.detach().requires_grad_()
            scores = self.score(leaf)
            (gradient,) = torch.autograd.grad(scores, leaf, torch.ones_like(scores))
        return scores.detach(), gradient

    def score_and_residuals(self, knots: Tensor) -> tuple[Tensor, Sequence[Tensor]]:
        """Scores (N,), and the residuals (..., N, R) whose norms the score adds up."""
        states = self._states(knots)
        return self._scores(knots, states), self.objective.residuals(self.start, states, self.goal)

    def predict(self, knots: Tensor) -> tuple[float, Tensor]:
        """Score and states (H, P, 1, S) of one candidate (K, A), usually remembered from the search."""
        if self.best is not None and torch.equal(self.best.knots, knots):
            return self.best.score, self.best.states
        states = self._states(knots[None])
        return float(self.objective(self.start, states, self.goal)[0]), states

    def _states(self, knots: Tensor) -> Tensor:
        return self.rollout.candidates(self.start, self.knots.expand(knots), self.noise)

    def _scores(self, knots: Tensor, states: Tensor) -> Tensor:
        scores = self.objective(self.start, states, self.goal)
        self._remember(scores.detach(), knots.detach(), states.detach())
        return scores

    def _remember(self, scores: Tensor, knots: Tensor, states: Tensor) -> None:
        score, index = usable(scores).max(0)
        if self.best is None or float(score) > self.best.score:
            self.best = _Scored(float(score), knots[index], states[:, :, index, None].clone())


class Mpc:
    """Plans for one plant; remembers its last plan until the goal or the episode changes."""

    def __init__(self, config: PlannerConfig, task: Task, objective: Objective | None = None) -> None:
        self._config = config
        self._action_dim = task.action_dim
        self._objective = objective or Objective.create(task, config)
        self._rollout: Predictor | None = None
        self._memory: _Memory | None = None

    def set_model(self, model: ParticleModel) -> None:
        """Plan through `model` from the next plan on; the last plan stays as the warm start."""
        self.set_predictor(Rollout(model, self._config.propagation))

    def set_predictor(self, predictor: Predictor) -> None:
        """As `set_model`, for what is no learned model: the true simulator."""
        self._rollout = predictor

    def reset(self) -> None:
        """Forget the last plan and its elites: a new episode begins."""
        self._memory = None

    @torch.no_grad()
    def plan(
        self, state: Tensor, goal: Tensor, committed: Tensor, steps_left: int, generator: torch.Generator
    ) -> Plan:
        """Plan from ŝ_{k+x}, which follows s_k (S,) through the committed actions (x, A); x = 0: from s_k.

        `steps_left` is the number of actions from k to the episode's end. It places this plan relative to
        the last one, so that the warm start is shifted by the steps in between. Goal (G,).
        """
        if self._rollout is None:
            raise RuntimeError("no model yet: call set_model first")
        start_left = steps_left - len(committed)
        knots = Knots(self._config.knots, self._horizon(start_left), self._config.interpolation, state.device)
        prefix = self._rollout.prefix(state, committed, generator)
        objective = self._objective.until(start_left - knots.horizon)
        problem = _Problem(self._rollout, objective, knots, prefix[-1], goal, generator)
        found = self._optimise(problem, self._warm(knots, goal, start_left).to(state))
        self._memory = _Memory(goal.clone(), start_left, knots.expand(_best_first(found)))
        return _describe(problem, found, prefix)

    @torch.no_grad()
    def predict(self, state: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and deviation (T, S) over particles of the states after s_k (S,) under actions (T, A)."""
        if self._rollout is None:
            raise RuntimeError("no model yet: call set_model first")
        noise = torch.Generator(state.device).manual_seed(0)
        return mean_and_std(self._rollout.prefix(state, actions, noise)[1:])

    def _horizon(self, start_left: int) -> int:
        if not self._config.horizon_to_episode_end:
            return self._config.horizon
        return max(1, min(self._config.horizon, start_left))

    def _warm(self, knots: Knots, goal: Tensor, start_left: int) -> Tensor:
        """The last plan's sequences as knots (E, K, A), shifted to this plan's start; else zero."""
        memory = self._memory
        if memory is None or start_left > memory.start_left or not torch.equal(goal, memory.goal):
            return torch.zeros(1, knots.count, self._action_dim)
        # CEM's fresh last action is zero, as DPETS has it; iCEM repeats the last one.
        tail = "zero" if self._config.search == "cem" else "repeat"
        return knots.sample(shift(memory.sequences, memory.start_left - start_left, knots.horizon, tail))

    def _optimise(self, problem: _Problem, warm: Tensor) -> Found:
        found = self._search(problem, warm)
        if not self._config.refines:
            return found
        refined = self._refined(problem, _best_first(found)[: self._config.refine_sequences])
        if not refined.valid:
            return found
        # Those that were not refined stay elites for the next plan's warm start.
        elites = torch.cat((refined.elites, found.elites[self._config.refine_sequences :]))
        return Found(refined.best, elites, refined.scores, valid=True)

    def _refined(self, problem: _Problem, start: Tensor) -> Found:
        config = self._config
        if config.refine == "adam":
            rate = config.refine_rate
            return refine(problem.score, problem.score_and_gradient, start, config.refine_steps, rate)
        difference = config.refine_difference
        return gauss_newton(
            problem.score, problem.score_and_residuals, start[0], config.refine_steps, difference
        )

    def _search(self, problem: _Problem, warm: Tensor) -> Found:
        config = self._config
        if config.search == "cem":
            return cem(problem.score, warm[0], config, problem.noise)
        if config.search == "icem":
            return icem(problem.score, warm[0], warm, config, problem.noise)
        return self._scatter(warm, problem.noise)

    def _scatter(self, warm: Tensor, generator: torch.Generator) -> Found:
        """Without a search: the warm start with a share of its elites, and draws around it."""
        config = self._config
        kept = warm[: max(1, round(config.keep_fraction * config.refine_sequences))]
        fresh = max(0, config.refine_sequences - len(kept))
        white = torch.randn((fresh, *warm.shape[1:]), generator=generator, device=generator.device)
        drawn = (warm[0] + config.init_std * white.to(warm)).clamp(LOW, HIGH)
        return Found(warm[0], torch.cat((kept, drawn)), warm.new_empty(0), valid=False)


def steps_per_plan(rate_hz: float, solve_s: float) -> int:
    """x = ⌈ν_system / ν_MPC⌉ (Sec. III-B): steps that the plant takes while a plan is made, at least 1."""
    return max(1, math.ceil(rate_hz * solve_s))


def _best_first(found: Found) -> Tensor:
    """The answer and the elites (E, K, A); CEM's answer, a mean, is none of its elites."""
    if len(found.elites) > 0 and torch.equal(found.elites[0], found.best):
        return found.elites
    return torch.cat((found.best[None], found.elites))


def _describe(problem: _Problem, found: Found, prefix: Tensor) -> Plan:
    score, states = problem.predict(found.best)
    mean, std = mean_and_std(torch.cat((prefix[1:], states)))
    return Plan(problem.knots.expand(found.best), score, mean, std, found.valid)

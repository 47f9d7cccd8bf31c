"""Analytic particle models and a task for them, whose plans can be computed by hand."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from common.task import Group
from services.planner.objective import Objective

DT_S = 0.2


@dataclass(frozen=True)
class Linear:
    """s' = s A_p + a B_p for P particles: A (P, S, S), B (P, A, S)."""

    A: Tensor
    B: Tensor

    @property
    def particles(self) -> int:
        return len(self.A)

    def step(self, state: Tensor, action: Tensor, noise: torch.Generator | None = None) -> Tensor:
        moved = state @ self.A + action @ self.B
        if noise is not None:
            moved = moved + torch.randn(moved.shape, generator=noise)
        return moved


def point_mass(gains: tuple[float, ...] = (1.0,)) -> Linear:
    """A mass on a line, state (position, velocity), action a force; a particle per gain of the force."""
    A = torch.tensor([[1.0, 0.0], [DT_S, 1.0]])
    B = torch.tensor([[0.0, DT_S]])
    return Linear(torch.stack([A for _ in gains]), torch.stack([gain * B for gain in gains]))


@dataclass(frozen=True)
class LineTask:
    """Bring the mass to a position: what the planner reads of a task."""

    state_dim: int = 2
    action_dim: int = 1
    goal_dim: int = 1
    groups: tuple[Group, ...] = (
        Group("qpos", 0, 1, "m", -50.0, 50.0),
        Group("qvel", 1, 2, "m/s", -50.0, 50.0),
    )

    def reward(self, state: Tensor, goal: Tensor) -> Tensor:
        return -((state[..., 0] - goal[0]) ** 2) - 0.05 * state[..., 1] ** 2

    def residuals(self, state: Tensor, goal: Tensor) -> tuple[Tensor, ...]:
        offset = torch.stack((state[..., 0] - goal[0], 0.05**0.5 * state[..., 1]), dim=-1)
        return (offset,)  # the reward is minus its squared norm, which has the same optimum

    def plausible(self, state: Tensor) -> Tensor:
        return (state.abs() < 50.0).all(-1)


def objective(task: LineTask, **weights: float) -> Objective:
    return Objective(task.reward, task.residuals, task.plausible, (slice(0, 1),), **weights)  # type: ignore[arg-type]


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)

"""What every task defines: state layout, achieved goal, rewards, errors and success, for numpy and torch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.geometry import Array, namespace
from common.task.layout import ACTUATOR_NAMES, FINGER_NAMES, JOINT_NAMES, Group


@dataclass(frozen=True)
class Task(ABC):
    """A goal-conditioned task: pure functions of a state (..., S) and a goal (G,) or (..., G).

    S state, A action, G goal dimensions. Positions in m in the world frame, quaternions wxyz, angles in rad;
    object_angular_velocity is in the object's own frame, as MuJoCo gives it. Actions are in [-1, 1].
    """

    name: str
    groups: tuple[Group, ...]
    goal_dim: int
    action_dim: int = len(ACTUATOR_NAMES)
    joint_names: tuple[str, ...] = JOINT_NAMES
    actuator_names: tuple[str, ...] = ACTUATOR_NAMES
    finger_names: tuple[str, ...] = FINGER_NAMES

    @property
    def state_dim(self) -> int:
        """S, the number of state dimensions."""
        return self.groups[-1].stop

    def group(self, name: str) -> Group:
        """The group called `name`. Raises KeyError naming those that there are."""
        for group in self.groups:
            if group.name == name:
                return group
        raise KeyError(f"{self.name} has no group {name}; it has {', '.join(g.name for g in self.groups)}")

    def plausible(self, state: Array) -> Array:
        """Whether each state (..., S) is finite and within every group's bounds: bool (...)."""
        xp = namespace(state)
        low, high = (xp.asarray(bound, dtype=state.dtype, device=state.device) for bound in self._bounds)
        inside = xp.all((state >= low) & (state <= high), axis=-1)  # no NaN is
        for group in self.groups:
            if group.kind == "quaternion":
                norm = xp.linalg.vector_norm(state[..., group.slice], axis=-1)
                inside = inside & (norm >= group.low) & (norm <= group.high)
        return inside

    @cached_property
    def _bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest value (S,) of each dimension; a quaternion's parts are bounded by its norm."""
        low, high = np.full(self.state_dim, -np.inf), np.full(self.state_dim, np.inf)
        for group in self.groups:
            if group.kind != "quaternion":
                low[group.slice], high[group.slice] = group.low, group.high
        return low, high

    @abstractmethod
    def dropped(self, state: Array) -> Array:
        """Whether the object has left the hand: bool (...); never for a task without one."""

    def straying(self, state: Array) -> Array:
        """How far (...), m, an object is from where it is well held; 0 for a task without such a place."""
        return namespace(state).zeros_like(state[..., 0])

    def sinking(self, state: Array) -> Array:
        """How far (...), m, an object has sunk out of the hand; 0 for a task without such a height."""
        return namespace(state).zeros_like(state[..., 0])

    @abstractmethod
    def achieved(self, state: Array) -> Array:
        """The goal (..., G) that each state (..., S) attains."""

    @abstractmethod
    def reward(self, state: Array, goal: Array) -> Array:
        """What the planner maximises (...): at most 0, differentiable, blind to a quaternion's sign."""

    @abstractmethod
    def residuals(self, state: Array, goal: Array) -> tuple[Array, ...]:
        """Vectors (..., R) whose norms add up to minus the reward, penalties for events aside."""

    @abstractmethod
    def compute_reward(self, achieved: Array, goal: Array) -> Array:
        """The dense reward (...) of attaining `achieved` (..., G), exactly as the environment's function."""

    def env_reward(self, state: Array, goal: Array) -> Array:
        """The environment's reward (...) in the states (..., S)."""
        return self.compute_reward(self.achieved(state), goal)

    @abstractmethod
    def errors(self, state: Array, goal: Array) -> dict[str, Array]:
        """Named distances (...) to the goal, the unit in each name."""

    @abstractmethod
    def successes(self, state: Array, goal: Array) -> dict[str, Array]:
        """Named verdicts, bool (...); `success_paper` and `success_env` exist for every task."""

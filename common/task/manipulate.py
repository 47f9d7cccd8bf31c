"""In-hand manipulation: bring an object to a given rotation, and for the egg also to a given position."""

from __future__ import annotations

from dataclasses import dataclass

from common import geometry
from common.geometry import Array, namespace
from common.task.task import Task


@dataclass(frozen=True)
class ManipulateTask(Task):
    """State (61,): qpos 24, qvel 24, object velocity 3 + 3, position 3, rotation 4; goal (7,): 3 and 4.

    `position_weight` is in rad/m; `position_counts` says whether reward and success look at position.
    In the hand an object's centre stays above 0.11 m, world frame; on the floor it is below 0.05 m.
    """

    position_counts: bool = False
    position_weight: float = 10.0
    paper_threshold_m: float = 0.005
    paper_threshold_rad: float = 0.5
    env_position_weight: float = 10.0
    env_threshold_m: float = 0.010
    env_threshold_rad: float = 0.1
    drop_height_m: float = 0.08
    # Where an object lies at the start of an episode, horizontally, world frame; and how it lies in the hand.
    middle_m: tuple[float, float] = (1.009, 0.871)
    middle_radius_m: float = 0.02
    held_height_m: float = 0.16

    def achieved(self, state: Array) -> Array:
        """Object position, m, and rotation, wxyz: (..., 7), world frame."""
        return state[..., self.group("object_position").start : self.group("object_rotation").stop]

    def dropped(self, state: Array) -> Array:
        """Whether the object's centre is below `drop_height_m`: bool (...)."""
        return state[..., self.group("object_position").stop - 1] < self.drop_height_m

    def straying(self, state: Array) -> Array:
        """How far (...), m, the object's centre is beyond `middle_radius_m` from `middle_m`, horizontally."""
        xp, start = namespace(state), self.group("object_position").start
        x, y = state[..., start] - self.middle_m[0], state[..., start + 1] - self.middle_m[1]
        return xp.clip(xp.sqrt(x * x + y * y + 1e-12) - self.middle_radius_m, 0.0, None)

    def sinking(self, state: Array) -> Array:
        """How far (...), m, the object's centre is lower than `held_height_m`, where it rests."""
        xp = namespace(state)
        return xp.clip(self.held_height_m - state[..., self.group("object_position").stop - 1], 0.0, None)

    def reward(self, state: Array, goal: Array) -> Array:
        """-(w·d_pos + d_rot) (...), d_rot = 2·arccos|⟨q, q*⟩| as in the paper's reward for the real hand.

        # Paper: the simulated tasks' own reward takes the long way round for half of all quaternion signs;
        # planning with the real hand's metric lets the model turn either way.
        """
        rotation = geometry.angle(self._rotation(state), goal[..., 3:])
        if not self.position_counts:
            return -rotation
        return -(self.position_weight * self._position_error(state, goal) + rotation)

    def residuals(self, state: Array, goal: Array) -> tuple[Array, ...]:
        """The turn that is left (..., 3), rad, and where position counts the weighted offset (..., 3)."""
        turn = geometry.turn(self._rotation(state), goal[..., 3:])
        if not self.position_counts:
            return (turn,)
        position = state[..., self.group("object_position").slice]
        return self.position_weight * (position - goal[..., :3]), turn

    def compute_reward(self, achieved: Array, goal: Array) -> Array:
        """The environment's -(10·d_pos + d_rot) (...) of a pose (..., 7), with d_rot signed in [0, 2π]."""
        rotation = geometry.signed_angle(achieved[..., 3:], goal[..., 3:])
        if not self.position_counts:
            return -rotation
        distance = namespace(achieved).linalg.vector_norm(achieved[..., :3] - goal[..., :3], axis=-1)
        return -(self.env_position_weight * distance + rotation)

    def errors(self, state: Array, goal: Array) -> dict[str, Array]:
        """Distance (m), shortest angle (rad) and the environment's signed angle (rad), each (...)."""
        rotation, wanted = self._rotation(state), goal[..., 3:]
        return {
            "position_m": self._position_error(state, goal),
            "rotation_rad": geometry.angle(rotation, wanted),
            "rotation_env_rad": geometry.signed_angle(rotation, wanted),
        }

    def successes(self, state: Array, goal: Array) -> dict[str, Array]:
        """bool (...): the paper's 0.5 rad (egg: and 5 mm), the environment's 0.1 rad (egg: and 10 mm)."""
        errors = self.errors(state, goal)
        paper = errors["rotation_rad"] < self.paper_threshold_rad
        env = errors["rotation_env_rad"] < self.env_threshold_rad
        if self.position_counts:
            paper = paper & (errors["position_m"] < self.paper_threshold_m)
            env = env & (errors["position_m"] < self.env_threshold_m)
        return {"success_paper": paper, "success_env": env}

    def _rotation(self, state: Array) -> Array:
        return state[..., self.group("object_rotation").slice]

    def _position_error(self, state: Array, goal: Array) -> Array:
        position = state[..., self.group("object_position").slice]
        return namespace(state).linalg.vector_norm(position - goal[..., :3], axis=-1)

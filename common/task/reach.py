"""HandReach: bring the five fingertips to given positions."""

from __future__ import annotations

from dataclasses import dataclass

from common.geometry import Array, namespace
from common.task.task import Task


@dataclass(frozen=True)
class ReachTask(Task):
    """State (63,): qpos 24, qvel 24, tips 15; goal (15,): fingertip positions, m, order of `finger_names`."""

    paper_threshold_m: float = 0.002
    env_threshold_m: float = 0.010

    def achieved(self, state: Array) -> Array:
        """Fingertip positions (..., 15), m, world frame."""
        return state[..., self.group("tips").slice]

    def dropped(self, state: Array) -> Array:
        """False (...): there is no object."""
        xp = namespace(state)
        return xp.zeros_like(state[..., 0], dtype=xp.bool)

    def reward(self, state: Array, goal: Array) -> Array:
        """-‖tips - goal‖₂ over the 15 dimensions (...), m."""
        return self.env_reward(state, goal)

    def residuals(self, state: Array, goal: Array) -> tuple[Array, ...]:
        """The fingertips' offsets from the goal (..., 15), m."""
        return (self.achieved(state) - goal,)

    def compute_reward(self, achieved: Array, goal: Array) -> Array:
        """The same (...) of fingertips `achieved` (..., 15): the environment's reward is the planner's."""
        return -namespace(achieved).linalg.vector_norm(achieved - goal, axis=-1)

    def finger_errors_m(self, state: Array, goal: Array) -> Array:
        """Distance of each fingertip to its goal (..., 5), m."""
        delta = self.achieved(state) - goal
        fingers = delta.reshape((*delta.shape[:-1], len(self.finger_names), 3))
        return namespace(state).linalg.vector_norm(fingers, axis=-1)

    def errors(self, state: Array, goal: Array) -> dict[str, Array]:
        """Mean and worst finger error and the norm over all 15 dimensions (...), m."""
        xp = namespace(state)
        fingers = self.finger_errors_m(state, goal)
        return {
            "mean_finger_m": xp.mean(fingers, axis=-1),
            "worst_finger_m": xp.amax(fingers, axis=-1),
            "norm_15d_m": xp.linalg.vector_norm(fingers, axis=-1),
        }

    def successes(self, state: Array, goal: Array) -> dict[str, Array]:
        """bool (...): 2 mm by mean finger, by worst finger and by 15-D norm; the environment's 10 mm by norm.

        # Paper: "2 mm" names no norm (Sec. IV-A); the mean finger is taken, the two others stand beside it.
        """
        errors = self.errors(state, goal)
        return {
            "success_paper": errors["mean_finger_m"] < self.paper_threshold_m,
            "success_worst": errors["worst_finger_m"] < self.paper_threshold_m,
            "success_15d": errors["norm_15d_m"] < self.paper_threshold_m,
            "success_env": errors["norm_15d_m"] < self.env_threshold_m,
        }

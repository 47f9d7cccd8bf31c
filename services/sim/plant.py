"""The simulated Shadow Hand as a plant: exactly repeatable resets, steps, snapshots and body poses.

Wraps the dense Gymnasium-Robotics environments without their time limit or rendering: how long an episode
lasts is its caller's decision. HandReach is v3: v2 starts from another pose than it documents.
"""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.task import Task, get_task
from services.sim.interface import Floats, PlantState, Snapshot

# Their import prints notices and warnings about environments that are not used here.
with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
    warnings.simplefilter("ignore")
    import gymnasium
    import gymnasium_robotics

# Paper: HandReach-v2 (Sec. II-B), which current releases refuse to make.
ENV_IDS = {
    "reach": "HandReachDense-v3",
    "egg": "HandManipulateEggDense-v1",
    "egg_rotate": "HandManipulateEggRotateDense-v1",
    "block": "HandManipulateBlockRotateXYZDense-v1",
}

# Where the object's rotation alone counts, its goal is shown this far beside it, as the environment does.
_GOAL_OFFSET_M = np.array([0.15, 0.0, 0.0])
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs
log = logging.getLogger(__name__)


class ShadowHandPlant:
    """One simulated hand with the named task: same seed and actions, same states, bit for bit."""

    def __init__(self, task_name: str, seed: int = 0) -> None:
        """Build the environment and reset it to `seed`. Raises ValueError for an unknown task."""
        self.task: Task = get_task(task_name)
        self.env = _make(ENV_IDS[task_name])
        self.model: Any = self.env.model
        self.data: Any = self.env.data
        self._body_ids = _shown_bodies(self.model)
        joints = [self.model.joint(f"robot0:{name}") for name in self.task.joint_names]
        self._joint_addresses = np.array([joint.qposadr[0] for joint in joints])
        self._state = np.zeros(self.task.state_dim)
        self.reset(seed)

    @property
    def goal(self) -> Floats:
        """The current goal (G,)."""
        return self.env.goal.copy()

    @property
    def state(self) -> Floats:
        """The state (S,) after the last reset, step or restore."""
        return self._state.copy()

    def reset(self, seed: int, goal: ArrayLike | None = None) -> PlantState:
        """Start the episode of `seed`, towards its own goal or `goal` (G,) if given."""
        # The manipulation environments keep the solver's warm start from the last episode, which would make
        # a start depend on what came before it.
        mujoco.mj_resetData(self.model, self.data)
        observation, _ = self.env.reset(seed=seed)
        self._state = observation["observation"]
        if goal is not None:
            self.set_goal(goal)
        return PlantState(self.state, self.goal)

    def step(self, action: ArrayLike) -> Floats:
        """Hold `action` (A,), clipped to [-1, 1], for one control step of 40 ms; the state (S,) after it.

        Raises ValueError if the action has another shape or is not finite; the plant has not moved then.
        """
        command = np.array(action, dtype=np.float64)
        if command.shape != (self.task.action_dim,) or not np.isfinite(command).all():
            raise ValueError(f"action must be {self.task.action_dim} finite numbers, got {command}")
        self._state = self.env.step(command)[0]["observation"]
        return self.state

    def set_goal(self, goal: ArrayLike) -> None:
        """Pursue `goal` (G,) from now on. Raises ValueError if it has another shape or is not finite."""
        wanted = np.array(goal, dtype=np.float64)
        if wanted.shape != (self.task.goal_dim,) or not np.isfinite(wanted).all():
            raise ValueError(f"goal must be {self.task.goal_dim} finite numbers, got {wanted}")
        self.env.goal = wanted

    def sample_goal(self, seed: int) -> Floats:
        """The goal (G,) that `reset(seed)` would set; the running episode is not disturbed."""
        before = self.save()
        goal = self.reset(seed).goal
        self.restore(before)
        return goal

    def save(self) -> Snapshot:
        """Everything needed to continue exactly from here."""
        physics = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self.model, self.data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        return Snapshot(physics, PlantState(self.state, self.goal))

    def restore(self, snapshot: Snapshot) -> PlantState:
        """Continue exactly from `snapshot`; what was observed then is observed again."""
        self._set_physics(snapshot.physics)
        mujoco.mj_forward(self.model, self.data)  # body poses
        self._set_physics(snapshot.physics)  # mj_forward has overwritten the solver's warm start
        self.env.goal = snapshot.observed.goal.copy()
        self._state = snapshot.observed.state.copy()
        return snapshot.observed

    def qpos(self, state: Floats) -> Floats:
        """The model's coordinates (nq,) that a state (S,) describes; what it does not tell stays as it is."""
        qpos = self.data.qpos.copy()
        qpos[self._joint_addresses] = state[self.task.group("qpos").slice]
        if self.task.name != "reach":
            start = int(self.model.joint("object:joint").qposadr[0])
            qpos[start : start + 7] = self.task.achieved(state)
        return qpos

    def bodies(self) -> tuple[tuple[str, ...], Floats, Floats]:
        """Names (n), positions (n, 3) m, quaternions wxyz (n, 4): bodies and goal markers, world frame."""
        names, positions, quaternions = self._goal_markers()
        shown = [self.model.body(i).name.removeprefix("robot0:") for i in self._body_ids]
        return (
            (*shown, *names),
            np.concatenate([self.data.xpos[self._body_ids], positions]),
            np.concatenate([self.data.xquat[self._body_ids], quaternions]),
        )

    def _goal_markers(self) -> tuple[tuple[str, ...], Floats, Floats]:
        if self.task.name == "reach":
            names = tuple(f"goal_{finger}" for finger in self.task.finger_names)
            return names, self.goal.reshape(-1, 3), np.tile(_IDENTITY, (len(names), 1))
        offset = 0.0 if self.task.name == "egg" else _GOAL_OFFSET_M
        return ("goal",), (self.goal[:3] + offset)[None], self.goal[None, 3:]

    def _set_physics(self, physics: Floats) -> None:
        mujoco.mj_setState(self.model, self.data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)


def _make(env_id: str) -> Any:
    # Without a handler MuJoCo appends its warnings to MUJOCO_LOG.TXT in the working directory.
    mujoco.set_mju_user_warning(log.warning)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gymnasium.register_envs(gymnasium_robotics)
        return gymnasium.make(env_id, disable_env_checker=True).unwrapped


def _shown_bodies(model: Any) -> NDArray[np.intp]:
    names = [model.body(i).name for i in range(model.nbody)]
    shown = [i for i, name in enumerate(names) if name.startswith("robot0:") or name == "object"]
    return np.array(shown, dtype=np.intp)

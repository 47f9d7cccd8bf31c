"""Body poses of the simulated scene from a state and a goal alone, for viewers and for predicted states."""

from __future__ import annotations

from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.sim.plants import make_plant
from services.sim.scene import Scene, export_scene

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs


class SceneKinematics:
    """Forward kinematics of the plant's own MuJoCo model; nothing is simulated."""

    def __init__(self, task_name: str) -> None:
        """Build the model of the named task. Raises ValueError for an unknown task."""
        self._plant = make_plant(task_name)
        self.task = self._plant.task

    def scene(self) -> Scene:
        """Meshes of all that `bodies` places."""
        return export_scene(self._plant)

    def bodies(
        self, state: ArrayLike, goal: ArrayLike
    ) -> tuple[tuple[str, ...], NDArray[np.float64], NDArray[np.float64]]:
        """Names (n), positions (n, 3) m, quaternions wxyz (n, 4), world frame, of state (S,) and goal (G,).

        Names and order are those of the plant's `bodies`. Raises ValueError for a goal of another shape.
        """
        data = self._plant.data
        data.qpos[:] = self._plant.qpos(np.asarray(state, dtype=np.float64))
        mujoco.mj_kinematics(self._plant.model, data)
        self._plant.set_goal(goal)
        return self._plant.bodies()

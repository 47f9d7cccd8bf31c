"""Body poses of the simulated scene from a state and a goal alone, for viewers and for predicted states."""

from __future__ import annotations

from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.sim.plant import ShadowHandPlant
from services.sim.scene import Scene, export_scene

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs


class SceneKinematics:
    """Forward kinematics of the environment's own MuJoCo model; nothing is simulated."""

    def __init__(self, task_name: str) -> None:
        """Build the model of the named task. Raises ValueError for an unknown task."""
        self._plant = ShadowHandPlant(task_name)
        self.task = self._plant.task
        model = self._plant.model
        joints = [model.joint(f"robot0:{name}") for name in self.task.joint_names]
        self._joint_addresses = np.array([joint.qposadr[0] for joint in joints])
        self._object_address = self._find_object()

    def _find_object(self) -> slice | None:
        if not any(group.name == "object_position" for group in self.task.groups):
            return None
        start = int(self._plant.model.joint("object:joint").qposadr[0])
        return slice(start, start + 7)

    def scene(self) -> Scene:
        """Meshes of all that `bodies` places."""
        return export_scene(self._plant)

    def bodies(
        self, state: ArrayLike, goal: ArrayLike
    ) -> tuple[tuple[str, ...], NDArray[np.float64], NDArray[np.float64]]:
        """Names (n), positions (n, 3) m, quaternions wxyz (n, 4), world frame, of state (S,) and goal (G,).

        Names and order are those of `ShadowHandPlant.bodies`. Raises ValueError for a goal of another shape.
        """
        values = np.asarray(state, dtype=np.float64)
        data = self._plant.data
        data.qpos[self._joint_addresses] = values[self.task.group("qpos").slice]
        if self._object_address is not None:
            data.qpos[self._object_address] = self.task.achieved(values)
        mujoco.mj_kinematics(self._plant.model, data)
        self._plant.set_goal(goal)
        return self._plant.bodies()

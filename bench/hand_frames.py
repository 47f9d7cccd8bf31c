"""Pictures of the simulated Shadow Hand in given states, with the goal shown, drawn without a screen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from services.sim.camera import Optics, SceneCamera
from services.sim.plant import ShadowHandPlant

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs
Frame = NDArray[np.uint8]  # (H, W, 3) RGB

# From the side of the environments' own view, but higher and nearer: the palm, and the goal beside it.
_LOOK_AT_M, _AZIMUTH_RAD, _ELEVATION_RAD = np.array([1.05, 0.89, 0.15]), np.radians(55.0), np.radians(-40.0)
_DISTANCE_M = 0.4
SIZE_PX = 180
_FINER = 2  # the camera has one sample a pixel; this many squared are averaged


class HandCamera:
    """Draws states of one task. Use and close it in one thread: it owns an OpenGL context."""

    def __init__(self, task: str) -> None:
        """Raises RuntimeError where neither EGL nor OSMesa can draw."""
        self._plant = ShadowHandPlant(task)
        drawn = _FINER * SIZE_PX
        optics = Optics(drawn, drawn, focal_px=1.4 * drawn, centre_px=((drawn - 1) / 2, (drawn - 1) / 2))
        self._camera = SceneCamera(self._plant.model, optics)

    def frame(self, state: ArrayLike, goal: ArrayLike) -> Frame:
        """A picture (H, W, 3) of the hand in a state (S,), the goal (G,) beside or in it."""
        plant = self._plant
        plant.set_goal(goal)
        plant.data.qpos[:] = plant.qpos(np.asarray(state, dtype=np.float64))
        mujoco.mj_forward(plant.model, plant.data)
        plant.env._render_callback()  # places the goal's marker
        self._camera.update(plant.data)
        drawn = self._camera.view(_pose()).colour.reshape(SIZE_PX, _FINER, SIZE_PX, _FINER, 3)
        return drawn.mean(axis=(1, 3)).astype(np.uint8)

    def close(self) -> None:
        """Free the context."""
        self._camera.close()


def strip(frames: Sequence[Frame]) -> Frame:
    """Pictures side by side."""
    return np.concatenate(frames, axis=1)


def _pose() -> NDArray[np.float64]:
    """The camera's pose (4, 4) in the world: x right, y down, z forward."""
    flat = np.cos(_ELEVATION_RAD)
    forward = np.array([flat * np.cos(_AZIMUTH_RAD), flat * np.sin(_AZIMUTH_RAD), np.sin(_ELEVATION_RAD)])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = _LOOK_AT_M - _DISTANCE_M * forward
    return pose

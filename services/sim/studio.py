"""The camera over the emulated hand: draws hand and die where they are, as a D435 would see them."""

from __future__ import annotations

from typing import Any

import cv2
import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import NDArray

from common import geometry
from common.camera_config import CameraConfig
from common.camera_messages import CameraFrame, TwinTruth
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import BOARDS
from services.sim.camera import Optics, SceneCamera
from services.sim.depth_noise import DepthNoise, DepthSensor
from services.sim.dexhand_model import mount_of
from services.sim.dexhand_physics import TwinPhysics
from services.sim.dexhand_twin import DexHandTwin

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs

COLOUR_NOISE = 1.5  # levels of 255, one deviation
BLUR_PX = 0.6
_SPARE_PX = 40  # by which the drawn noise is larger than the picture: another part is used each time
_NO_FORCE = np.zeros(sum(board.has_tactile for board in BOARDS))


class Studio:
    """`draw` must always be called by the same thread: it owns an OpenGL context, made at the first call."""

    def __init__(self, config: CameraConfig, hand: DexHandConfig, physics: TwinPhysics, seed: int) -> None:
        self._config = config
        self._twin = DexHandTwin(hand.hand, seed, assumed=hand, physics=physics)
        self._optics = Optics(config.width, config.height, config.focal_px, config.centre_px)
        self._rng = np.random.default_rng(seed)
        self._sensor = DepthSensor(self._optics, DepthNoise(), seed, config.rate_hz)
        shape = config.height + _SPARE_PX, config.width + _SPARE_PX, 3
        self._static = self._rng.normal(0.0, COLOUR_NOISE, shape).astype(np.float32)
        self._camera: SceneCamera | None = None
        self._T_world_camera = _world_palm(self._twin) @ config.T_palm_camera

    def draw(self, truth: TwinTruth, t_ns: int, number: int) -> CameraFrame:
        """What the camera sees of that. Raises RuntimeError where there is no OpenGL."""
        if self._camera is None:
            self._camera = SceneCamera(self._twin.model, self._optics, shadows=self._config.shadows)
        state = np.concatenate([truth.q_rad, _NO_FORCE, truth.position, truth.rotation], dtype=np.float64)
        self._twin.data.qpos[:] = self._twin.qpos(state)
        mujoco.mj_kinematics(self._twin.model, self._twin.data)
        mujoco.mj_camlight(self._twin.model, self._twin.data)
        self._camera.update(self._twin.data)
        view = self._camera.view(self._T_world_camera)
        return CameraFrame(
            colour=self._exposed(view.colour),
            depth=self._sensor.measure(view.depth_m),
            depth_unit_m=DepthNoise().unit_m,
            camera_matrix=self._optics.camera_matrix,
            colour_time_ns=t_ns,
            depth_time_ns=t_ns,
            frame_number=number,
        )

    def _exposed(self, colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
        height, width = colour.shape[:2]
        row, column = self._rng.integers(0, _SPARE_PX, 2)
        noise = self._static[row : row + height, column : column + width]
        blurred = cv2.GaussianBlur(colour, (3, 3), BLUR_PX)
        return np.asarray(cv2.add(blurred, noise, dtype=cv2.CV_8U), np.uint8)


def _world_palm(twin: DexHandTwin) -> NDArray[np.float64]:
    """From the palm's frame to the world's (4, 4)."""
    transform = np.eye(4)
    mount = mount_of(twin.task)
    transform[:3, :3] = geometry.rotate(np.broadcast_to(mount, (3, 4)), np.eye(3)).T
    transform[2, 3] = twin.physics.table_m
    return transform

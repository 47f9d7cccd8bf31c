"""A camera in a MuJoCo scene: colour and true depth by an OpenCV camera matrix, without a screen.

Camera frame: OpenCV optical, x right, y down, z forward. Letters: H rows, W columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import NDArray

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs
Float64 = NDArray[np.float64]

NEAR_M, FAR_M = 0.05, 10.0
_NO_DEPTH_M = 0.99 * FAR_M  # the sky


@dataclass(frozen=True)
class Optics:
    """Intrinsics of colour and stereo pair; the defaults are those of a real D435 at 640 x 480.

    Source: the recording `single_depth_color_640x480.bag` of librealsense.
    """

    width: int = 640
    height: int = 480
    focal_px: float = 613.2
    centre_px: tuple[float, float] = (321.4, 241.7)
    stereo_focal_px: float = 390.4
    stereo_baseline_m: float = 0.05017

    @property
    def camera_matrix(self) -> Float64:
        """K (3, 3) of the colour camera; pixel centres are at whole numbers."""
        (cx, cy), f = self.centre_px, self.focal_px
        return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class View:
    """Colour (H, W, 3) RGB and depth (H, W), metres along the optical axis, 0 where nothing is."""

    colour: NDArray[np.uint8]
    depth_m: NDArray[np.float32]


class SceneCamera:
    """Draws one model. Use it in the thread that made it, and close it there: it owns an OpenGL context."""

    def __init__(self, model: Any, optics: Optics, max_geoms: int = 400, shadows: bool = True) -> None:
        """Raises RuntimeError where neither EGL nor OSMesa can draw."""
        self.optics = optics
        self._model = model
        # One sample a pixel: with more, depth at edges is of neither side, and drawing takes far longer.
        model.vis.quality.offsamples = 0
        model.vis.global_.offwidth, model.vis.global_.offheight = optics.width, optics.height
        self._gl = _offscreen_context(optics.width, optics.height)
        self._gl.make_current()
        self._context: Any = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self.scene: Any = mujoco.MjvScene(model, maxgeom=max_geoms)
        self.cast_shadows(shadows)
        self.options: Any = mujoco.MjvOption()
        self._rectangle: Any = mujoco.MjrRect(0, 0, optics.width, optics.height)

    def cast_shadows(self, cast: bool) -> None:
        """Draw shadows from now on, or not; they are three quarters of the work of a picture."""
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = cast

    def update(self, data: Any) -> None:
        """Take over where everything is; geoms may be added to `scene` after this and before `view`."""
        camera, all_kinds = mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self.options, None, camera, all_kinds, self.scene)

    def view(self, T_world_camera: Float64, shift_px: tuple[float, float] = (0.0, 0.0)) -> View:
        """Draw from a pose (4, 4), the picture moved by a fraction of a pixel if wanted."""
        rows, columns = self.optics.height, self.optics.width
        self._aim(T_world_camera, shift_px)
        colour, buffer = np.empty((rows, columns, 3), np.uint8), np.empty((rows, columns), np.float32)
        self._draw(colour, buffer)
        return View(np.ascontiguousarray(colour[::-1]), _metres(buffer[::-1]))

    def depth(self, T_world_camera: Float64) -> NDArray[np.float32]:
        """Depth (H, W) alone, m: without lights a third of the time; what is transparent counts as solid."""
        self._aim(T_world_camera, (0.0, 0.0))
        buffer = np.empty((self.optics.height, self.optics.width), np.float32)
        flags = self.scene.flags.copy()
        for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
            self.scene.flags[flag] = 1
        self._draw(None, buffer)
        self.scene.flags[:] = flags
        return _metres(buffer[::-1])

    def close(self) -> None:
        """Free the context; may be called twice."""
        if self._context is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._context = None

    def _draw(self, colour: NDArray[np.uint8] | None, buffer: NDArray[np.float32]) -> None:
        self._gl.make_current()
        mujoco.mjr_render(self._rectangle, self.scene, self._context)
        mujoco.mjr_readPixels(colour, buffer, self._rectangle, self._context)

    def _aim(self, T_world_camera: Float64, shift_px: tuple[float, float]) -> None:
        """MuJoCo sees through two eyes; both get the same pose and frustum."""
        optics, scale = self.optics, NEAR_M / self.optics.focal_px
        cx, cy = np.add(optics.centre_px, shift_px)
        left, right = (-0.5 - cx) * scale, (optics.width - 0.5 - cx) * scale
        for eye in self.scene.camera:
            eye.pos = T_world_camera[:3, 3]
            eye.forward, eye.up = T_world_camera[:3, 2], -T_world_camera[:3, 1]
            eye.frustum_near, eye.frustum_far = NEAR_M, FAR_M
            eye.frustum_center, eye.frustum_width = (left + right) / 2, (right - left) / 2
            eye.frustum_top, eye.frustum_bottom = (cy + 0.5) * scale, (cy + 0.5 - optics.height) * scale
            eye.orthographic = 0


def _metres(buffer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Undo the projection of a depth buffer that is 1 at NEAR_M and 0 at FAR_M."""
    depth = NEAR_M * FAR_M / (NEAR_M + buffer * (FAR_M - NEAR_M))
    return np.where(depth < _NO_DEPTH_M, depth, np.float32(0.0)).astype(np.float32)


def _offscreen_context(width: int, height: int) -> Any:
    """EGL, else OSMesa; asked for by name, so that the choice needs no environment variable."""
    problems: list[str] = []
    for name in ("egl", "osmesa"):
        try:
            module: Any = __import__(f"mujoco.{name}", fromlist=["GLContext"])
            return module.GLContext(width, height)
        except Exception as error:  # what is missing shows in many ways: ImportError, AttributeError, GLError
            problems.append(f"{name}: {error}")
    raise RuntimeError(
        "no OpenGL without a screen: sudo apt-get install libegl1 libgl1-mesa-dri "
        f"({'; '.join(problems)})".replace("\n", " ")
    )

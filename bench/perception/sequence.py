"""One sequence: what is asked for, and its frames with the truth about each.

Truth is of the moment in the middle of the exposure, which is also the capture time of both pictures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from bench.perception.looks import HELD_OUT, LIGHTINGS, TUNING
from bench.perception.motion import GRIPS, DieMotion, Fingers, Wave
from bench.perception.scene import FilmSet
from common.dice import APPEARANCES
from services.perception.frames import Frame
from services.sim.depth_noise import DepthNoise, DepthSensor

cv2: Any = compiled_cv2  # its stubs do not know which type an array keeps
Float64 = NDArray[np.float64]

EXPOSURE = 0.35  # of the time between frames
EXPOSURE_SWING = 0.25  # automatic exposure wanders by so much
_VISIBLE_M = 0.001  # what is nearer than the die by more covers it
# Drawn twice an exposure, at opposite quarters of a pixel: that smooths edges as well as it blurs motion.
# Shadows are drawn once: so they are half as dark as those of a single small lamp, and cost half.
_EXPOSED = ((-0.25, (0.25, -0.25), True), (0.25, (-0.25, 0.25), False))


@dataclass(frozen=True)
class Spec:
    """What a sequence is: same spec, same frames, bit for bit on one machine."""

    name: str
    seed: int
    frames: int
    held_out: bool = True  # which palette of tables, fingers and palms
    rate_hz: float = 60.0
    distance_m: float = 0.42
    speed_deg_s: float = 70.0
    grip: str = "held"
    appearance: str = "white"
    lighting: str = "lab"


class Truth(NamedTuple):
    """About one frame: pose (4, 4) and which share of the die's own picture something covers."""

    T_camera_die: Float64
    occlusion: float


def film(spec: Spec) -> Iterator[tuple[Frame, Truth]]:
    """Draw the sequence frame by frame."""
    director = _Director(spec)
    try:
        for number in range(spec.frames):
            yield director.shoot(number)
    finally:
        director.close()


class _Director:
    def __init__(self, spec: Spec) -> None:
        # Held-out and tuning sequences of the same seed have nothing in common.
        rng = np.random.default_rng([spec.seed, int(spec.held_out)])
        self._spec = spec
        self._look, self._lighting = APPEARANCES[spec.appearance], LIGHTINGS[spec.lighting]
        self._motion = DieMotion(rng, spec.speed_deg_s, spec.frames / spec.rate_hz)
        self._T_world_camera = _camera_pose(rng, spec.distance_m)
        towards = self._T_world_camera[:3, 3]
        self._fingers = Fingers(rng, self._look.die, GRIPS[spec.grip], towards)
        self._set = FilmSet(self._look, self._lighting, HELD_OUT if spec.held_out else TUNING, rng)
        self._sensor = DepthSensor(
            self._set.camera.optics, DepthNoise(), int(rng.integers(2**31)), spec.rate_hz
        )
        self._gain = Wave(rng, 1, 0.3)
        self._static = rng.normal(0.0, self._lighting.noise, (520, 700, 3)).astype(np.float32)
        self._rng = rng

    def shoot(self, number: int) -> tuple[Frame, Truth]:
        """Picture `number` of the sequence, as the camera would take it, and what is true of it."""
        t_s = number / self._spec.rate_hz
        colour = self._colour(t_s)
        self._arrange(t_s)
        depth_m = self._set.camera.depth(self._T_world_camera)
        alone = self._set.die_alone(self._T_world_camera)
        visible = (alone > 0) & (depth_m > alone - _VISIBLE_M)
        occlusion = 1.0 - visible.sum() / max(int((alone > 0).sum()), 1)
        depth = self._sensor.measure(self._seen_into(depth_m, visible))
        t_ns = round((t_s + 1.0) * 1e9)
        optics = self._set.camera.optics
        frame = Frame(colour, depth, DepthNoise().unit_m, optics.camera_matrix, t_ns, t_ns, number)
        return frame, Truth(self._pose(t_s), float(occlusion))

    def close(self) -> None:
        self._set.close()

    def _pose(self, t_s: float) -> Float64:
        position, rotation = self._motion.pose(t_s)
        return np.linalg.inv(self._T_world_camera) @ _matrix(position, rotation)

    def _arrange(self, t_s: float) -> None:
        position, rotation = self._motion.pose(t_s)
        rods = self._fingers.capsules(t_s, position, rotation)
        self._set.arrange(position, rotation, rods)

    def _colour(self, t_s: float) -> NDArray[np.uint8]:
        total = np.zeros((480, 640, 3), np.float32)
        for moment, shift, shadows in _EXPOSED:
            self._arrange(t_s + moment * EXPOSURE / self._spec.rate_hz)
            self._set.camera.cast_shadows(shadows)
            total += self._set.camera.view(self._T_world_camera, shift).colour
        gain = (1.0 + EXPOSURE_SWING * float(self._gain(t_s)[0])) / len(_EXPOSED)
        row, column = self._rng.integers(0, (40, 60))
        total = cv2.GaussianBlur(total * np.float32(gain), (3, 3), 0.6)
        total += self._static[row : row + 480, column : column + 640]
        return np.clip(total, 0, 255).astype(np.uint8)

    def _seen_into(self, depth_m: NDArray[np.float32], visible: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Infrared is scattered back from within a translucent body: too far, and partly nothing."""
        clear = 1.0 - self._look.opacity
        if clear <= 0:
            return depth_m
        field = cv2.resize(self._rng.standard_normal((48, 64), np.float32), depth_m.shape[::-1])
        deeper = depth_m + np.float32(0.016 * clear) * (1.0 + field)
        return np.where(visible, np.where(field > 1.0, np.float32(0.0), deeper), depth_m)


def _camera_pose(rng: np.random.Generator, distance_m: float) -> Float64:
    """Looking at the world's origin from above, from any side, with any roll: (4, 4)."""
    azimuth, elevation, roll = rng.uniform((0, 0.7, 0), (6.28, 1.35, 6.28))
    backward = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    across = np.cross((0.0, 0.0, 1.0), backward)
    across /= np.linalg.norm(across)
    down = np.cross(-backward, across)
    pose = np.eye(4)
    pose[:3, 0] = np.cos(roll) * across + np.sin(roll) * down
    pose[:3, 1] = np.cos(roll) * down - np.sin(roll) * across
    pose[:3, 2], pose[:3, 3] = -backward, distance_m * backward
    return pose


def _matrix(position: Float64, rotation: Float64) -> Float64:
    w, x, y, z = rotation
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = position
    return pose

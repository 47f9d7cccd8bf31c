"""Puts perception together from its configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.built import Built
from common.camera_config import CameraConfig
from common.camera_messages import PoseResetReply
from common.config import ConfigError, load
from common.desk import Desk
from common.dice import APPEARANCES
from common.die import Die
from common.die_file import read_die
from common.service import Port
from common.topics import RESET_REQUEST
from services.perception import realsense
from services.perception.backend import PoseBackend
from services.perception.calibration import SAME_K_SHARE, Calibration
from services.perception.camera_port import CameraPort
from services.perception.config import PerceptionConfig, PerceptionProcess
from services.perception.cpu.backend import CpuBackend
from services.perception.cube import CubeBackend
from services.perception.foundationpose import FoundationPoseBackend
from services.perception.frames import Float64
from services.perception.palm_tag import PalmTag
from services.perception.polish import Polisher
from services.perception.reach import Reach
from services.perception.sam6d import Sam6dSegmenter
from services.perception.service import PerceptionService
from services.perception.sources import SDK_SUFFIXES, open_source
from services.perception.worker import PoseWorker, Segment

QUERY = "pose/reset"


@dataclass(frozen=True)
class Place:
    """Where the camera is: in the palm's frame (4, 4), what is wrong with a K (3, 3), and the palm's tag."""

    T_palm_camera: Float64
    misfit: Callable[[Float64], str]
    tag: PalmTag | None


def build(config: PerceptionProcess, boot_id: int) -> Built:
    """Make the service, its workers' part, its camera and its desk. Raises ConfigError."""
    own = config.perception
    die, place = _die(own.die), place_of(own, config.camera)
    backend = backend_of(own, die, config.run_dir)
    worker = PoseWorker(backend, _segment(config, die, place), die, place.tag)
    desk = Desk("reset", boot_id, RESET_REQUEST, PoseResetReply, lambda why: PoseResetReply(False, "", why))
    ports: dict[str, Port] = {"reset": desk}
    if own.source.kind == "bus":
        service = PerceptionService(own, worker, place.T_palm_camera, place.misfit, boot_id)
        return Built(service, ports, {QUERY: desk.answer})
    _check_sdk(own)
    port = CameraPort(lambda: open_source(own.source), own.source.kind == "recording")
    service = PerceptionService(own, worker, place.T_palm_camera, place.misfit, boot_id, camera=port.report)
    return Built(service, ports | {port.name: port}, {QUERY: desk.answer})


def _segment(config: PerceptionProcess, die: Die, place: Place) -> Segment:
    """Where a search looks."""
    own = config.perception
    if own.mask == "sam6d":
        return Sam6dSegmenter(own.sam6d, die, config.run_dir / "sam6d").mask
    return Reach(own.reach, place.T_palm_camera).mask


def _check_sdk(config: PerceptionConfig) -> None:
    path = config.source.path
    if config.source.kind == "realsense" or (path is not None and path.suffix in SDK_SUFFIXES):
        try:
            realsense.sdk()
        except ImportError as error:
            raise ConfigError([f"perception.source: {error}"]) from None


def _die(name: str) -> Die:
    if name in APPEARANCES:
        return APPEARANCES[name].die
    if not Path(name).is_file():
        known = ", ".join(APPEARANCES)
        raise ConfigError([f"perception.die: {name} is neither a file nor one of {known}"])
    return read_die(Path(name))


def backend_of(config: PerceptionConfig, die: Die, run_dir: Path) -> PoseBackend:
    """Who finds the die. Raises ConfigError when it cannot."""
    if config.backend == "cpu":
        return CpuBackend(die)
    if config.backend == "foundationpose":
        folder = run_dir / "foundationpose"
        return FoundationPoseBackend(config.foundationpose, die, Polisher(die).judge, folder)
    try:
        return CubeBackend(config.aruco, die)
    except ValueError as error:
        raise ConfigError([f"perception: {error}"]) from None


def place_of(config: PerceptionConfig, camera: CameraConfig) -> Place:
    """From the calibration file, or where the emulated camera is. Raises ConfigError."""
    if config.calibration is None and config.source.kind != "bus":
        advice = "make it with python -m services.perception.calibrate, see docs/guides/perception.md"
        raise ConfigError([f"perception.calibration: missing: where is the camera? {advice}"])
    if config.calibration is None:
        return Place(camera.T_palm_camera, _misfit_of(camera.camera_matrix), None)
    calibration = load(Calibration, config.calibration)
    tag = PalmTag(calibration.tag, config.knock) if calibration.tag else None
    return Place(calibration.T_palm_camera, calibration.misfit, tag)


def _misfit_of(expected: Float64) -> Callable[[Float64], str]:
    """The same as Calibration.misfit, for a camera that has no such file."""

    def misfit(camera_matrix: Float64) -> str:
        off = float(np.abs(camera_matrix - expected).max() / expected[0, 0])
        if off <= SAME_K_SHARE:
            return ""
        return f"pictures have fx {camera_matrix[0, 0]:.1f}, camera.focal_px says {expected[0, 0]:.1f}"

    return misfit

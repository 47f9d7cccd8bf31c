"""`python -m services.sim.twin_camera --config FILE`: the camera over the emulated hand, as a process."""

from __future__ import annotations

from common.built import Built
from common.camera_config import CameraConfig
from common.cell import SharedConfig
from common.dexhand021.config import DexHandConfig
from common.process import run_process
from services.sim.camera_service import FAULT_QUERY, CameraFaults, CameraService
from services.sim.dexhand_physics import TwinPhysics
from services.sim.studio import Studio


class TwinCameraProcess(SharedConfig):
    """What the camera process is started with."""

    hand: DexHandConfig = DexHandConfig()
    camera: CameraConfig = CameraConfig()
    twin: TwinPhysics = TwinPhysics()


def build(config: TwinCameraProcess, boot_id: int) -> Built:
    """Make the service, and what it draws with."""
    faults = CameraFaults()
    studio = Studio(config.camera, config.hand, config.twin, config.seed)
    return Built(
        CameraService(config.camera, studio.draw, faults, boot_id), {}, {FAULT_QUERY: faults.answer_query}
    )


if __name__ == "__main__":
    run_process("camera", TwinCameraProcess, build)

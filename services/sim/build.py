"""Puts the simulated hand together from its configuration."""

from __future__ import annotations

from common.built import Built
from common.cell import SharedConfig
from common.dexhand021.glove_config import GloveConfig
from common.dexhand021.glove_files import read_demonstrations
from common.task import get_task
from services.sim.dexhand_physics import TwinPhysics
from services.sim.plants import make_plant
from services.sim.port import PlantPort
from services.sim.service import SimService

# Live, the bus's threads get the processor to send a state before the physics takes it: Linux lets a thread
# that woke wait for the one that runs, which made every state 1.4 ms late.
HEAD_START_S = 0.001


class SimProcess(SharedConfig):
    """What the sim process is started with: what is not here, such as start poses, is the plant's own."""

    twin: TwinPhysics = TwinPhysics()
    glove: GloveConfig = GloveConfig()


def build(config: SimProcess, boot_id: int, head_start_s: float = 0.0) -> Built:
    """Make the service and the simulated hand that it drives, which waits `head_start_s` before it moves.

    Raises ConfigError for a bad glove file.
    """
    demonstrations = read_demonstrations(config.glove, config.control.rate_hz)
    service = SimService(config, get_task(config.task), boot_id, demonstrations)
    plant = make_plant(config.task, config.control.rate_hz, config.twin)
    return Built(service, {"plant": PlantPort(plant, head_start_s)})


def build_live(config: SimProcess, boot_id: int) -> Built:
    """As `build`, for a process of its own."""
    return build(config, boot_id, HEAD_START_S)

"""`python -m services.sim.emulator --config FILE`: a DexHand 021 on a simulated CAN bus, as a process.

It answers as six boards do, over the physics of the twin: what drives it cannot tell it from a hand.
"""

from __future__ import annotations

from common.built import Built
from common.config import ConfigError
from common.process import run_process
from common.task import get_die_task
from services.sim.dexhand_twin import DexHandTwin
from services.sim.emulator_config import EmulatorProcess
from services.sim.emulator_port import FAULT_QUERY, EmulatorPort
from services.sim.emulator_service import EmulatorService


def build(config: EmulatorProcess, boot_id: int) -> Built:
    """Make the hand, its bus, and who looks after it. Raises ConfigError for a task without a die."""
    try:
        task = get_die_task(config.task, config.hand.hand)
    except ValueError as error:
        raise ConfigError([str(error)]) from None
    twin = DexHandTwin(config.hand.hand, config.seed, assumed=config.hand, physics=config.twin)
    port = EmulatorPort(config.can, config.hand, config.emulator, twin, task)
    service = EmulatorService(config, boot_id)
    return Built(service, {"twin": port}, {FAULT_QUERY: port.answer_query})


if __name__ == "__main__":
    run_process("emulator", EmulatorProcess, build)

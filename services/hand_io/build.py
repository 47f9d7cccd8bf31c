"""Puts the real hand together from its configuration."""

from __future__ import annotations

from common.built import Built
from common.config import ConfigError
from common.dexhand021.glove_files import read_demonstrations
from common.task import get_die_task
from services.hand_io.config import HandIoProcess
from services.hand_io.desk import QUERY, ArmDesk
from services.hand_io.driver import HandPort
from services.hand_io.service import HandIoService


def build(config: HandIoProcess, boot_id: int) -> Built:
    """Make the service, the driver and the desk for people.

    Raises ConfigError for a task it cannot do, and for a bad glove file.
    """
    try:
        task = get_die_task(config.task, config.hand.hand)
    except ValueError as error:
        raise ConfigError([str(error)]) from None
    demonstrations = read_demonstrations(config.glove, config.control.rate_hz)
    service = HandIoService(config, task, boot_id, demonstrations)
    desk = ArmDesk(boot_id)
    port = HandPort(config.can, config.hand, config.hand_io)
    return Built(service, {"hand": port, "arm": desk}, {QUERY: desk.answer})

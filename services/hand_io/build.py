"""Puts the real hand together from its configuration."""

from __future__ import annotations

import numpy as np

from common.built import Built
from common.config import ConfigError
from common.message_fields import Float32
from common.task import DieTask, get_task
from common.task.die import GOAL_FACES
from services.hand_io.config import HandIoProcess
from services.hand_io.desk import QUERY, ArmDesk
from services.hand_io.driver import HandPort
from services.hand_io.service import HandIoService


def build(config: HandIoProcess, boot_id: int) -> Built:
    """Make the service, the driver and the desk for people. Raises ConfigError for a task it cannot do."""
    task = get_task(config.task)
    if not isinstance(task, DieTask):
        raise ConfigError([f"task: {config.task} is none for the DexHand 021; it has: die"])

    def draw_goal(seed: int) -> Float32:
        face = int(np.random.default_rng(seed).choice(GOAL_FACES))
        return task.goal(face).astype(np.float32)

    service = HandIoService(config, task, draw_goal, boot_id)
    desk = ArmDesk(boot_id)
    port = HandPort(config.can, config.hand, config.hand_io)
    return Built(service, {"hand": port, "arm": desk}, {QUERY: desk.answer})

"""The simulated hand as a device: commands in, one frame out for each."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from common.messages import Message, PlantCommand, PlantFrame
from common.topics import PLANT_FRAME, Topic
from services.sim.interface import Plant


class PlantPort:
    """Executes each command at once; the frame that it delivers is what the hand shows a step later.

    `head_start_s` is how long it waits before the physics, so that what was published just before gets away.
    """

    name = "plant"

    def __init__(self, plant: Plant, head_start_s: float = 0.0) -> None:
        self._plant = plant
        self._head_start_s = head_start_s
        self._deliver: Callable[[Topic, Message], None] = lambda _topic, _message: None

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Remember whom to tell."""
        self._deliver = deliver

    def write(self, message: Message) -> None:
        """Reset, change the goal or act, then deliver the new state."""
        if not isinstance(message, PlantCommand):
            raise TypeError(f"the plant takes PlantCommand, got {type(message).__name__}")
        if message.reset:
            self._plant.reset(message.seed, message.goal if message.goal.size else None)
        elif message.goal.size:
            self._plant.set_goal(message.goal)
        if message.action.size:
            time.sleep(self._head_start_s)
            self._plant.step(message.action)
        self._deliver(PLANT_FRAME, self._frame(message.reset))

    def _frame(self, reset: bool) -> PlantFrame:
        state = self._plant.state
        dropped = bool(self._plant.task.dropped(state))
        return PlantFrame(state.astype(np.float32), self._plant.goal.astype(np.float32), dropped, reset)

    def close(self) -> None:
        """Nothing to do: a simulated hand is safe wherever it stops."""

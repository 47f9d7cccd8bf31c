"""The simulated hand: episodes on its own clock, each step as soon as its device has answered."""

from __future__ import annotations

import numpy as np

from common.bus import Inbox, Input
from common.cell import SharedConfig
from common.demonstrations import Demonstrations
from common.executor import Executed
from common.messages import Float32, PlantCommand, PlantFrame
from common.plant_loop import PlantLoop, Seen
from common.service import Output, Report, ToPort
from common.task import Task
from common.topics import ACK, CHUNK, EPISODE, PLANT_COMMAND, PLANT_FRAME

_EMPTY: Float32 = np.zeros(0, np.float32)


class SimulatedHand:
    """Says to the device what the loop wants of the hand."""

    def reset(self, seed: int, goal: Float32) -> list[Output]:
        """Begin the episode of `seed`."""
        return [_command(reset=True, seed=seed, goal=goal)]

    def pursue(self, goal: Float32) -> list[Output]:
        """Show `goal` (G,) from now on."""
        return [_command(goal=goal)]

    def act(self, executed: Executed) -> list[Output]:
        """Execute an action (A,) for one control step."""
        return [_command(action=executed.action)]


def _command(reset: bool = False, seed: int = 0, goal: Float32 = _EMPTY, action: Float32 = _EMPTY) -> Output:
    return ToPort("plant", PLANT_COMMAND, PlantCommand(reset, seed, goal, action))


class SimService:
    """Warm-up episodes run as fast as the device answers; all others at the control rate."""

    name = "sim"
    inputs = (
        Input(EPISODE, newest=True, wake=True),
        Input(CHUNK, wake=True),
        Input(ACK),
        Input(PLANT_FRAME, wake=True),
    )

    def __init__(
        self, config: SharedConfig, task: Task, boot_id: int, demonstrations: Demonstrations | None = None
    ) -> None:
        self.period_ns: int | None = config.control.period_ns
        self._all_valid = np.ones(len(task.groups), np.uint8)
        self._no_age = np.zeros(len(task.groups), np.float32)
        self._loop = PlantLoop(config.control, task, boot_id, SimulatedHand(), demonstrations)

    @property
    def boot_id(self) -> int:
        """Id of this start of the plant."""
        return self._loop.boot_id

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Take over frames, episodes and chunks, then move on if it is time to."""
        frames = inbox.take(PLANT_FRAME)
        for sample in frames:
            self._take_frame(sample.message)
        for sample in inbox.take(ACK):
            self._loop.take_ack(sample.message)
        out: list[Output] = []
        for sample in inbox.take(EPISODE):
            out += self._loop.take_episode(sample.message)
        for sample in inbox.take(CHUNK):
            self._loop.take_chunk(sample, now_ns)
        return out + self._loop.advance(inbox.ticks, warmup_due=bool(frames))

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving: an unfinished episode is run again after the restart."""
        return []

    def report(self) -> Report:
        """Counts since the start of the process."""
        return Report(self._loop.phase.value, self._loop.fields())

    def _take_frame(self, frame: PlantFrame) -> None:
        self._loop.see(Seen(frame.state, self._all_valid, self._no_age, frame.goal, frame.dropped))
        if frame.reset:
            self._loop.has_reset()

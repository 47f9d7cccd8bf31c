"""The emulated hand on its bus: one thread that answers at once and keeps the physics going in between.

Two threads would take the interpreter from each other at every frame: answers then came up to 3 ms later.
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable
from queue import SimpleQueue

import numpy as np
from pydantic import ValidationError

from common.can_config import CanConfig
from common.can_link import BadFrame, BusOff, Busy, CanLink, LinkError
from common.clock import Clock, Ticker, WallClock
from common.config import ConfigError, parse
from common.dexhand021.config import DexHandConfig
from common.dexhand021.frames import Frame
from common.hand_messages import TwinCommand, TwinFrame
from common.messages import Message
from common.task import DieTask
from common.topics import TWIN_FRAME, Topic
from services.sim.can_emulator import EmulatedHand
from services.sim.emulator_config import EmulatorConfig, Fault, FaultKind
from services.sim.emulator_sensors import TwinLike

FAULT_QUERY = "emulator/fault"
FRAMES_A_ROUND = 64  # answered at most before a round that is due
LIFT_M = 0.002  # the die is laid down from so high
NS_PER_S = 1e9


class EmulatorPort:
    """Runs an EmulatedHand live; delivers the truth behind it `pose_hz` times a second."""

    name = "twin"

    def __init__(
        self,
        can: CanConfig,
        hand: DexHandConfig,
        config: EmulatorConfig,
        twin: TwinLike,
        task: DieTask,
        *,
        clock: Clock | None = None,
    ) -> None:
        self._config = config
        self._can = can
        self._twin, self._task = twin, task
        self._clock = clock or WallClock()
        self.hand = EmulatedHand(hand, config, twin, self._clock.now_ns())
        self._faults: SimpleQueue[Fault] = SimpleQueue()  # told of, to begin with the next round
        self._stop = threading.Event()
        self._lay = threading.Event()
        self._was_off = False
        self._late: list[tuple[int, Frame]] = []  # answers that are not due yet
        self._deliver: Callable[[Topic, Message], None] = lambda _topic, _message: None
        self._thread = threading.Thread(target=self._live, name="emulated hand", daemon=True)
        self._link: CanLink | None = None

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Join the bus and come to life. Raises LinkError."""
        self._deliver = deliver
        self._link = CanLink(self._can)
        self._thread.start()

    def write(self, message: Message) -> None:
        """Lay the die into the hand."""
        if not isinstance(message, TwinCommand):
            raise TypeError(f"the twin takes TwinCommand, got {type(message).__name__}")
        if message.lay_die:
            self._lay.set()

    def close(self) -> None:
        """Leave the bus."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._link is not None:
            self._link.close()

    def inject(self, fault: Fault) -> None:
        """Have a fault from the next round of physics on."""
        self._faults.put(fault)

    def answer_query(self, payload: bytes) -> bytes:
        """Take a fault as JSON; the answer is empty, or says what is wrong with it."""
        try:
            fault = parse(Fault, json.loads(payload), "fault")
        except (ConfigError, ValueError, TypeError, ValidationError) as error:
            return str(error).encode()
        self.inject(fault)
        return b""

    # --- the thread -------------------------------------------------------------------------------

    def _live(self) -> None:
        ticker = Ticker(round(NS_PER_S / self._config.physics_hz), self._clock.now_ns())
        poses = Ticker(round(NS_PER_S / self._config.pose_hz), self._clock.now_ns())
        while not self._stop.is_set():
            self._answer_until(ticker.next_ns)
            now_ns = self._clock.now_ns()
            ticker.take(now_ns)
            self._send(self._round(now_ns))
            if poses.take(now_ns):
                self._deliver(TWIN_FRAME, self._frame())

    def _answer_until(self, end_ns: int) -> None:
        """Answer what comes, and what has come while a round took too long: neither may starve the other."""
        answered = 0
        while not self._stop.is_set():
            left_ns = end_ns - self._clock.now_ns()
            heard = self._answer(max(left_ns, 0) / NS_PER_S)
            answered += heard
            if left_ns <= 0 and (not heard or answered >= FRAMES_A_ROUND):
                return

    def _answer(self, wait_s: float) -> bool:
        """Wait for a frame and answer it; whether something came."""
        assert self._link is not None
        try:
            frame = self._link.receive(wait_s)
        except (BadFrame, BusOff):
            return True  # what is no frame is none of the boards' business
        except LinkError:
            self._stop.wait(wait_s)
            return False
        if frame is None:
            return False
        now_ns = self._clock.now_ns()
        answers = self.hand.receive(now_ns, frame)
        self._send([answer for due_ns, answer in answers if due_ns <= now_ns])
        self._late += [(due_ns, answer) for due_ns, answer in answers if due_ns > now_ns]
        return True

    def _send(self, frames: list[Frame]) -> None:
        assert self._link is not None
        for frame in frames:
            with contextlib.suppress(Busy, BusOff, LinkError):
                self._link.send(frame)

    def _round(self, now_ns: int) -> list[Frame]:
        """A round of physics and of whatever else has become due; what is to be sent after it."""
        while not self._faults.empty():
            self.hand.faults.add(now_ns, self._faults.get())
        if self._lay.is_set():
            self._lay.clear()
            position = np.array(self._task.start_position) + LIFT_M * np.array(self._task.up)
            self._twin.place_die(position, self._task.start_rotation)
        said = self.hand.advance(now_ns)
        self._tell_bus_off(now_ns)
        due = [frame for at_ns, frame in self._late if at_ns <= now_ns]
        self._late = [(at_ns, frame) for at_ns, frame in self._late if at_ns > now_ns]
        return [*said, *due]

    def _tell_bus_off(self, now_ns: int) -> None:
        assert self._link is not None
        off = self.hand.faults.active(now_ns, FaultKind.BUS_OFF)
        if off and not self._was_off:
            with contextlib.suppress(Busy, BusOff, LinkError):  # the boards are deaf all the same
                self._link.send_bus_off()
        self._was_off = off

    def _frame(self) -> TwinFrame:
        position, rotation = self._twin.die_pose()
        return TwinFrame(
            t_ns=self._clock.now_ns(),
            position=position.astype(np.float32),
            rotation=rotation.astype(np.float32),
            holding=self._twin.holding,
            q_rad=self.hand.sensors.angle_rad.astype(np.float32),
            powered=self.hand.powered.astype(np.uint8),
            counts={name: float(count) for name, count in self.hand.counts.items()},
        )

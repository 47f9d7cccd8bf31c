"""From the service's commands to what is sent: ramp, hold, release, and the limits as the last word."""

# pyright: strict

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.angles import to_radians, to_wire_cdeg
from common.dexhand021.commands import (
    BoardMotion,
    BroadcastMotion,
    Command,
    MotorTarget,
    ShortMotion,
    ShortTarget,
)
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import BOARDS, LOW_RAD, MOTORS, ControlMode, board_id
from common.hand_messages import Drive, HandCommand
from services.hand_io.interpolate import Ramp
from services.hand_io.limits import Gate, Reason, Request, SafeSetPoints, Sensed
from services.hand_io.limits_config import LimitsConfig

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SAME_RAD = 2e-4  # the wire's unit is 1.7e-4


class SetPoints:
    """Follows commands; without one for `hold_ns` it lets go. Starts without torque.

    A gate lives from power-on to release, so that every motor starts from where its sensor says it is.
    """

    def __init__(self, limits: LimitsConfig, hand: DexHandConfig, hold_ns: int) -> None:
        self._limits, self._hand, self._hold_ns = limits, hand, hold_ns
        self._gate: Gate | None = None
        self._ramp = Ramp.still(0, LOW_RAD)
        self._commanded_ns = 0
        self._current = np.full(MOTORS, hand.current, np.int64)
        self._lost: Bool = np.zeros(MOTORS, np.bool_)
        self._past: Counter[Reason] = Counter()  # of gates that are gone
        self.drive = Drive.OFF
        self.sent = SafeSetPoints(LOW_RAD, np.zeros(MOTORS, np.int64), np.zeros(MOTORS, np.bool_))
        self.limited: Bool = np.zeros(MOTORS, np.bool_)

    @property
    def counts(self) -> Counter[Reason]:
        """What the limits had to change since the start of the process."""
        return self._past + (self._gate.counts if self._gate else Counter())

    def command(self, now_ns: int, command: HandCommand, sensed: Sensed) -> None:
        """Take over what the service wants."""
        self._commanded_ns = now_ns
        if command.drive is Drive.OFF:
            self.release()
            return
        if self._gate is None:
            self._gate = Gate(self._limits, self._hand)
            self._ramp = Ramp.still(now_ns, np.where(np.isnan(sensed.angle_rad), LOW_RAD, sensed.angle_rad))
        elif command.drive is Drive.HOLD and self.drive is not Drive.HOLD:
            self._ramp = Ramp.still(now_ns, self.sent.position_rad)  # where it is, not where it was to go
        if command.drive is Drive.FOLLOW:
            target = to_radians(command.action)
            self._ramp = self._ramp.towards(now_ns, target, max(1, command.duration_ns))
        self.drive = command.drive

    def release(self) -> None:
        """Take the torque off all motors now."""
        self.drive = Drive.OFF
        self.sent = replace(self.sent, enabled=np.zeros(MOTORS, np.bool_))
        if self._gate is not None:
            self._past += self._gate.counts
            self._gate = None
            self._lost = np.zeros(MOTORS, np.bool_)

    def step(self, now_ns: int, sensed: Sensed, silent: Bool) -> SafeSetPoints:
        """The set points of this moment; motors (12,) whose board is `silent`, or starts anew, are released.

        Such a board may have been without power, and somebody may have moved its joints: at the old set point
        it would jump. Its motors start from a fresh reading; a hand that only holds starts none.
        """
        if now_ns - self._commanded_ns > self._hold_ns:
            self.release()
        if self._gate is None:
            measured = np.where(np.isnan(sensed.angle_rad), LOW_RAD, sensed.angle_rad)
            nothing = np.zeros(MOTORS, np.int64)
            self.sent = SafeSetPoints(measured, nothing, nothing.astype(np.bool_))
            self.limited = np.ones(MOTORS, np.bool_)
            return self.sent
        self._lost = silent | (self._lost if self.drive is Drive.HOLD else np.zeros_like(silent))
        asked = self._ramp.at(now_ns)
        self.sent = self._gate.step(now_ns, Request(asked, self._current), replace(sensed, lost=self._lost))
        self.limited = ~(np.abs(self.sent.position_rad - asked) <= SAME_RAD)
        return self.sent

    def commands(self) -> list[Command]:
        """What to send for the newest set points: one broadcast, or one command for each board."""
        safe, hand = self.sent, self._hand
        mode = ControlMode.ZERO_TORQUE if self.drive is Drive.OFF else hand.control_mode
        position = to_wire_cdeg(safe.position_rad, np.array(hand.signs))
        motors = [
            MotorTarget(bool(on), int(angle), hand.speed, int(current))
            for on, angle, current in zip(safe.enabled, position, safe.current, strict=True)
        ]
        if hand.motion == "broadcast":
            return [BroadcastMotion(hand.hand, mode, tuple(motors))]
        pairs = [(motors[2 * board], motors[2 * board + 1]) for board in range(len(BOARDS))]
        boards = [board_id(hand.hand, board) for board in range(len(BOARDS))]
        if hand.motion == "board":
            return [BoardMotion(board, mode, pair) for board, pair in zip(boards, pairs, strict=True)]
        return [
            ShortMotion(board, mode, (_short(pair[0]), _short(pair[1])))
            for board, pair in zip(boards, pairs, strict=True)
        ]


def _short(target: MotorTarget) -> ShortTarget:
    return ShortTarget(target.enabled, target.position)

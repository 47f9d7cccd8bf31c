"""A hand as its bus sees it: frames in, frames out, physics in between. Pure: time comes in as `now_ns`.

Letters: 12 motors, 6 boards, 5 fingertips in the order of common.dexhand021.tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from common.dexhand021 import device
from common.dexhand021.angles import from_wire_cdeg
from common.dexhand021.commands import (
    BoardMotion,
    BroadcastMotion,
    ClearError,
    Command,
    FeedbackSetting,
    MotorTarget,
    NvmRead,
    ShortMotion,
    ShortTarget,
)
from common.dexhand021.config import DexHandConfig
from common.dexhand021.frames import Frame, Refusal, padded
from common.dexhand021.replies import (
    ConfigReply,
    ErrorReport,
    MotorFlag,
    NvmReply,
    OverTemperature,
    Reply,
    Startup,
)
from common.dexhand021.tables import (
    BOARDS,
    CLEAR_ERROR,
    CONFIGURE_FEEDBACK,
    HIGH_RAD,
    LOW_RAD,
    MOTORS,
    ControlMode,
    FeedbackMode,
    NvmAddress,
    board_id,
    hand_and_board,
)
from services.sim.emulator_config import EmulatorConfig, FaultKind
from services.sim.emulator_faults import Faults
from services.sim.emulator_sensors import Sensors, TwinLike

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

NS_PER_S = 1e9
COOL_C, SAFE_C, STALL_MS = 30, 55, 500
SAME_RAD = 2e-4  # a set point so little beyond its range is rounding
_ANGLE_MODES = (ControlMode.CASCADED_PID, ControlMode.MIT_TORQUE, ControlMode.IMPEDANCE_GRASP)


class EmulatedHand:
    """Six boards over a twin. `receive` answers from the last round of `advance` and never waits for it."""

    def __init__(self, hand: DexHandConfig, config: EmulatorConfig, twin: TwinLike, now_ns: int) -> None:
        self._hand, self._config, self._twin = hand, config, twin
        self.faults = Faults(config.faults, now_ns)
        self._then_ns = now_ns
        self._signs = np.array(hand.signs)
        self._target_rad = twin.joint_angles_rad.copy()
        self._enabled = np.zeros(MOTORS, np.bool_)
        self._heard_ns = np.full(len(BOARDS), -(10**15))  # the last motion command of each board
        self._latched = np.zeros(MOTORS, np.bool_)
        self._off = False  # without power
        self._last_round: list[Frame] = []
        self.sensors = Sensors(twin, hand.signs)
        self._statuses = [self._status(now_ns, board) for board in range(len(BOARDS))]
        self.powered: Bools = np.zeros(MOTORS, np.bool_)
        self.counts: Counter[str] = Counter()

    # --- frames -----------------------------------------------------------------------------------

    def receive(self, now_ns: int, frame: Frame) -> list[tuple[int, Frame]]:
        """Obey a frame; the answers, each with the time at which it goes out."""
        self.counts["frames"] += 1
        if self._off or self.faults.active(now_ns, FaultKind.BUS_OFF):
            return []
        command = device.decode(frame)
        if isinstance(command, Refusal):
            self.counts["refused"] += 1
            return []
        return self._disturbed(now_ns, self._obey(now_ns, command))

    def _obey(self, now_ns: int, command: Command) -> list[Frame]:
        match command:
            case BroadcastMotion():
                if command.hand is not self._hand.hand:
                    return []
                self._move(now_ns, 0, command.mode, command.motors)
                heard = [b for b in range(len(BOARDS)) if not self._deaf(now_ns, b)]
                return [self._statuses[board] for board in heard] if command.request_feedback else []
            case _:
                hand, board = hand_and_board(command.board)
                if hand is not self._hand.hand or self._deaf(now_ns, board):
                    return []
                return [self._answer(now_ns, board, command)]

    def _answer(
        self,
        now_ns: int,
        board: int,
        command: BoardMotion | ShortMotion | ClearError | FeedbackSetting | NvmRead,
    ) -> Frame:
        match command:
            case BoardMotion() | ShortMotion():
                self._move(now_ns, board, command.mode, command.motors)
                return self._statuses[board]
            case ClearError():
                self._latched[2 * board : 2 * board + 2] = False
                return self._encode(ConfigReply(command.board, CLEAR_ERROR, ok=True))
            case FeedbackSetting():  # only answers to commands are emulated, which is the default
                only = command.mode is FeedbackMode.QUERY
                return self._encode(ConfigReply(command.board, CONFIGURE_FEEDBACK, ok=only))
            case NvmRead():
                return self._encode(NvmReply(command.board, command.address, self._memory(command)))

    def _memory(self, command: NvmRead) -> int:
        values = {
            NvmAddress.BOARD_ID: command.board,
            NvmAddress.FIRMWARE: self._config.firmware,
            NvmAddress.SAFE_TEMPERATURE_C: SAFE_C,
        }
        return values.get(command.address, STALL_MS)

    def _move(
        self, now_ns: int, first: int, mode: ControlMode, targets: Sequence[MotorTarget | ShortTarget]
    ) -> None:
        """Obey the set points for the boards from `first` (0-5) on."""
        motors = slice(2 * first, 2 * first + len(targets))
        boards = range(first, first + len(targets) // 2)
        hears = np.repeat([not self._deaf(now_ns, board) for board in boards], 2)
        enabled = np.array([target.enabled for target in targets]) & (mode in _ANGLE_MODES)
        wanted = from_wire_cdeg([target.position for target in targets], self._signs[motors])
        follows = hears & enabled & ~self._latched[motors]
        outside = np.maximum(LOW_RAD[motors] - wanted, wanted - HIGH_RAD[motors]) > SAME_RAD
        # Counted here, for the twin cuts it: what a real board does with such a set point is not public.
        self.counts["beyond_range"] += int(np.count_nonzero(follows & outside))
        self._target_rad[motors] = np.where(follows, wanted, self._target_rad[motors])
        self._enabled[motors] = np.where(hears, enabled, self._enabled[motors])
        self._heard_ns[boards] = np.where(hears[::2], now_ns, self._heard_ns[boards])

    def _deaf(self, now_ns: int, board: int) -> bool:
        return self.faults.active(now_ns, FaultKind.SILENT, board)

    def _encode(self, reply: Reply) -> Frame:
        # A controller pads to lengths that CAN FD has; the simulated buses would pass any.
        return padded(device.encode(reply, self._config.feedback_bytes))

    def _disturbed(self, now_ns: int, answers: list[Frame]) -> list[tuple[int, Frame]]:
        delay_ns = round(1e6 * self.faults.amount(now_ns, FaultKind.DELAY))
        if self.faults.active(now_ns, FaultKind.REORDER):
            answers, self._last_round = [*reversed(answers), *self._last_round], answers
        if self.faults.active(now_ns, FaultKind.DUPLICATE):
            answers = [frame for frame in answers for _ in range(2)]
        self.counts["answers"] += len(answers)
        return [(now_ns + delay_ns, frame) for frame in answers]

    # --- physics ----------------------------------------------------------------------------------

    def advance(self, now_ns: int) -> list[Frame]:
        """Let the physics catch up, at most five rounds; what the boards say of their own accord."""
        said = self._follow_faults(now_ns)
        fresh = now_ns - self._heard_ns <= self._config.silence_s * NS_PER_S
        self.powered = self._enabled & ~self._latched & np.repeat(fresh, 2) & (not self._off)
        round_s = 1.0 / self._config.physics_hz
        elapsed_s = min((now_ns - self._then_ns) / NS_PER_S, 5 * round_s)
        self._then_ns = now_ns
        self.sensors.drift_rad += elapsed_s * self._drifting(now_ns)
        self._twin.set_powered(self.powered)
        self._twin.set_targets(np.where(self.powered, self._target_rad, np.nan))
        if elapsed_s > 0.0:
            self._twin.advance(elapsed_s)
            self.sensors.measure(elapsed_s)
        # What a motor does while it has no torque is where it starts from when it gets some.
        here = np.clip(self.sensors.angle_rad, LOW_RAD, HIGH_RAD)
        self._target_rad = np.where(self.powered, self._target_rad, here)
        self._statuses = [self._status(now_ns, board) for board in range(len(BOARDS))]
        return said

    def _drifting(self, now_ns: int) -> Floats:
        rates = [self.faults.amount(now_ns, FaultKind.DRIFT, board) for board in range(len(BOARDS))]
        return np.repeat(rates, 2)

    def _follow_faults(self, now_ns: int) -> list[Frame]:
        said = [*self._stall(now_ns), *self._switch(now_ns)]
        if self._off or self.faults.active(now_ns, FaultKind.BUS_OFF):
            said = [reply for reply in said if isinstance(reply, OverTemperature)]
        return [self._encode(reply) for reply in said]

    def _stall(self, now_ns: int) -> list[Reply]:
        """An obstructed motor that has torque latches an error, and latches it again once it is cleared."""
        said: list[Reply] = []
        for board, motor in self.faults.stalls(now_ns):
            index = 2 * board + motor
            if self._enabled[index] and not self._latched[index]:
                self._latched[index] = True
                affected = (motor == 0, motor == 1)
                flags = tuple(MotorFlag.STALL if here else MotorFlag(0) for here in affected)
                said.append(ErrorReport(self._id(board), affected, (flags[0], flags[1]), b""))
                self.counts["stalls"] += 1
        return said

    def _switch(self, now_ns: int) -> list[Reply]:
        """Lose power and get it back, and say so as far as the boards can."""
        hot = [b for b in range(len(BOARDS)) if self.faults.active(now_ns, FaultKind.OVERHEAT, b)]
        was_off, self._off = self._off, bool(hot) or self.faults.active(now_ns, FaultKind.POWER)
        if self._off and not was_off:
            self.counts["power_offs"] += 1
            return [OverTemperature(self._id(board)) for board in hot]
        if was_off and not self._off:
            self._enabled[:], self._latched[:] = False, False
            nothing = bytes(self._config.startup_bytes)
            return [Startup(self._id(board), nothing) for board in range(len(BOARDS))]
        return []

    def _id(self, board: int) -> int:
        return board_id(self._hand.hand, board)

    def _status(self, now_ns: int, board: int) -> Frame:
        warm_c = round(self.faults.amount(now_ns, FaultKind.WARM, board)) or COOL_C
        blind = self.faults.active(now_ns, FaultKind.NAN_TACTILE, board)
        return self._encode(self.sensors.status(board, self._id(board), warm_c, self._latched, blind))

"""What the six boards have reported: the newest value of everything, its age, and what is wrong.

Letters: 12 motors, 6 boards, 5 fingertips in the order of common.dexhand021.tables. Pure: time comes in as
`now_ns`; NaN stands for never measured, or marked as invalid by the hand.
"""

# pyright: strict

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.angles import from_wire_cdeg
from common.dexhand021.commands import ClearError
from common.dexhand021.config import DexHandConfig
from common.dexhand021.replies import (
    BoardFeedback,
    ErrorReport,
    MotorFlag,
    OverTemperature,
    Reply,
    Startup,
    WarningReport,
)
from common.dexhand021.tables import BOARDS, HIGH_RAD, LOW_RAD, MOTORS, board_id, hand_and_board
from services.hand_io.limits import Sensed

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

NEVER_NS = 10**15
IMPLAUSIBLE_RAD = 0.5  # so far beyond its range no joint can be: the reading is wrong
RATE_SHARE = 0.1  # of a new interval in the smoothed one
_TIP = tuple(i for i, board in enumerate(BOARDS) if board.has_tactile)  # boards with a fingertip


class Boards:
    """Takes replies of one hand; those of another on the same bus are counted and passed over."""

    def __init__(
        self, hand: DexHandConfig, clear_ns: int, max_clear_ns: int, resume_c: float, rest_ns: int
    ) -> None:
        self._hand = hand
        self._clear_ns, self._max_clear_ns = clear_ns, max_clear_ns
        self._resume_c, self._rest_ns = resume_c, rest_ns
        self._signs = np.array(hand.signs)
        self.angle_rad = np.full(MOTORS, np.nan)
        self.current_ma = np.zeros(MOTORS)
        self.force_n = np.full(len(_TIP), np.nan)
        self.temperature_c = np.full(len(BOARDS), np.nan)
        self.overheated = np.zeros(len(BOARDS), np.bool_)
        self._overheated_ns = 0  # when any board last said so
        self._status_flags = np.zeros(MOTORS, np.int64)  # of the newest status
        self._reported_flags = np.zeros(MOTORS, np.int64)  # of error frames, until they are cleared
        self._heard_ns = np.full(len(BOARDS), -NEVER_NS)
        self._restarted = np.zeros(len(BOARDS), np.bool_)
        self._interval_ns = np.full(len(BOARDS), np.nan)
        self._pause_ns = np.full(len(BOARDS), clear_ns)
        self._clear_at_ns = np.full(len(BOARDS), -1)  # -1: nothing to clear
        self.counts: Counter[str] = Counter()

    def take(self, now_ns: int, reply: Reply) -> int | None:
        """Take one reply; returns the board 0-5 whose status it was, if it was one."""
        hand, board = hand_and_board(reply.board)
        if hand is not self._hand.hand:
            self.counts["other_hand"] += 1
            return None
        match reply:
            case BoardFeedback():
                self._status(now_ns, board, reply)
                return board
            case ErrorReport(_, _, flags):
                self.counts["error_frames"] += 1
                self._reported_flags[_motors(board)] |= _bits(flags)
            case OverTemperature():
                self.counts["overheats"] += 1
                self.overheated[board] = True
                self._overheated_ns = now_ns
                self.temperature_c[board] = np.nan  # it is over only when a newer reading says so
            case WarningReport():
                self.counts["warnings"] += 1
            case Startup():
                self._start(board)
            case _:
                self.counts["answers"] += 1
        return None

    def _start(self, board: int) -> None:
        if self._hand.startup_frame != "restart":
            self.counts["ignored_starts"] += 1
            return
        self.counts["starts"] += 1
        self._restarted[board] = True
        self._heard_ns[board] = -NEVER_NS  # what it said before is of another time

    def take_restarted(self) -> Bool:
        """Which boards (6,) have started anew since the last call."""
        restarted, self._restarted = self._restarted, np.zeros(len(BOARDS), np.bool_)
        return restarted

    def _status(self, now_ns: int, board: int, status: BoardFeedback) -> None:
        motors = _motors(board)
        angle = from_wire_cdeg([motor.angle_cdeg for motor in status.motors], self._signs[motors])
        beyond = np.maximum(LOW_RAD[motors] - angle, angle - HIGH_RAD[motors]) > IMPLAUSIBLE_RAD
        self.counts["implausible"] += int(np.count_nonzero(beyond))
        self.angle_rad[motors] = np.where(beyond, self.angle_rad[motors], angle)
        self.current_ma[motors] = [motor.current_ma for motor in status.motors]
        if status.errors is not None:
            self._status_flags[motors] = _bits(status.errors)
        if board in _TIP:
            normal = status.tactile.normal_n if status.tactile else None
            self.force_n[_TIP.index(board)] = np.nan if normal is None else normal
        if status.temperature_c is not None:
            self.temperature_c[board] = status.temperature_c
            self.overheated[board] &= status.temperature_c > self._resume_c
        elif not BOARDS[board].has_tactile:
            self.overheated[board] &= not self._palm_is_cool(now_ns)
        self._note_interval(now_ns, board)

    def _palm_is_cool(self, now_ns: int) -> bool:
        """The palm has no reading: it counts as hot as the hottest, and never as cool at once."""
        rested = now_ns - self._overheated_ns >= self._rest_ns
        return rested and bool(np.fmax.reduce(self.temperature_c) <= self._resume_c)

    def _note_interval(self, now_ns: int, board: int) -> None:
        interval = float(now_ns - self._heard_ns[board])
        self._heard_ns[board] = now_ns
        if interval < NEVER_NS / 2:
            old = self._interval_ns[board]
            self._interval_ns[board] = interval if np.isnan(old) else old + RATE_SHARE * (interval - old)

    @property
    def flags(self) -> Int64:
        """Error bits (12,) of the motors."""
        return self._status_flags | self._reported_flags

    def sensed(self) -> Sensed:
        """What the limits want to know."""
        return Sensed(self.angle_rad.copy(), self.temperature_c.copy(), self.flags != 0)

    def age_ns(self, now_ns: int) -> Int64:
        """Time (6,) since each board was heard."""
        return now_ns - self._heard_ns

    def rate_hz(self, now_ns: int) -> Float64:
        """Replies a second (6,) of each board, falling once it is silent."""
        slowest = np.fmax(self._interval_ns, self.age_ns(now_ns).astype(np.float64))
        return np.where(np.isnan(self._interval_ns), 0.0, 1e9 / np.maximum(slowest, 1.0))

    def clears(self, now_ns: int) -> list[ClearError]:
        """Commands for the boards whose latched error is due to be cleared; the pauses between them grow."""
        flagged = (self.flags != 0).reshape(len(BOARDS), 2).any(axis=1)
        due: list[ClearError] = []
        for board in range(len(BOARDS)):
            if not flagged[board]:
                self._settle(now_ns, board)
            elif self._clear_at_ns[board] < 0:
                self._clear_at_ns[board] = now_ns + self._pause_ns[board]
            elif now_ns >= self._clear_at_ns[board]:
                due.append(self._clear(now_ns, board))
        return due

    def _clear(self, now_ns: int, board: int) -> ClearError:
        self._pause_ns[board] = min(2 * self._pause_ns[board], self._max_clear_ns)
        self._clear_at_ns[board] = now_ns + self._pause_ns[board]
        self._reported_flags[_motors(board)] = 0  # an error that persists is reported again
        self.counts["clears"] += 1
        return ClearError(board_id(self._hand.hand, board))

    def _settle(self, now_ns: int, board: int) -> None:
        """Forget the grown pause once the board has been without error for as long as the longest."""
        if self._clear_at_ns[board] >= 0 and now_ns >= self._clear_at_ns[board] + self._max_clear_ns:
            self._clear_at_ns[board], self._pause_ns[board] = -1, self._clear_ns


def _motors(board: int) -> slice:
    return slice(2 * board, 2 * board + 2)


def _bits(flags: tuple[MotorFlag, MotorFlag]) -> Int64:
    return np.array([int(flag) for flag in flags], np.int64)

"""What a computer may ask of the hand, as values; each is valid by construction.

There is deliberately no value for a global function, a memory write or a flash save: what cannot be named
cannot be sent.
"""

from __future__ import annotations

from dataclasses import dataclass

from common.dexhand021.tables import (
    FEEDBACK_PERIOD_UNIT_MS,
    MAX_CURRENT,
    MAX_POSITION,
    MAX_SPEED,
    MOTORS,
    ControlMode,
    FeedbackMode,
    Hand,
    NvmAddress,
    is_board,
)


def _demand(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} {value} is outside {low} to {high}")


@dataclass(frozen=True)
class MotorTarget:
    """Set point of one motor in wire units; raises ValueError for what the wire cannot carry.

    `position` is 0.01° in the angle modes and Hall counts in the Hall modes; `speed` is nominally motor rpm;
    `current`'s unit is not public.
    """

    enabled: bool
    position: int
    speed: int = 15000
    current: int = 20

    def __post_init__(self) -> None:
        """Refuse what the wire would wrap."""
        _demand("position", self.position, -MAX_POSITION - 1, MAX_POSITION)
        _demand("speed", self.speed, 0, MAX_SPEED)
        _demand("current", self.current, 0, MAX_CURRENT)


@dataclass(frozen=True)
class ShortTarget:
    """Set point of one motor in the 6-byte command, which older firmware knows: no speed, no current."""

    enabled: bool
    position: int

    def __post_init__(self) -> None:
        """Refuse what the wire would wrap."""
        _demand("position", self.position, -MAX_POSITION - 1, MAX_POSITION)


@dataclass(frozen=True)
class BoardMotion:
    """Move the two motors (distal, proximal; palm: thumb rotation, spread) of one board; 12 bytes."""

    board: int  # 1-12
    mode: ControlMode
    motors: tuple[MotorTarget, MotorTarget]

    def __post_init__(self) -> None:
        """Refuse a board that does not exist."""
        _demand_board(self.board)


@dataclass(frozen=True)
class ShortMotion:
    """As BoardMotion, in 6 bytes."""

    board: int  # 1-12
    mode: ControlMode
    motors: tuple[ShortTarget, ShortTarget]

    def __post_init__(self) -> None:
        """Refuse a board that does not exist."""
        _demand_board(self.board)


@dataclass(frozen=True)
class BroadcastMotion:
    """Move all motors (12, in the order of JOINTS) of a hand with one frame.

    `clear_errors` is reported to do nothing on the hand: clear per board.
    """

    hand: Hand
    mode: ControlMode
    motors: tuple[MotorTarget, ...]
    request_feedback: bool = True
    clear_errors: bool = False

    def __post_init__(self) -> None:
        """Refuse any number of motors but twelve."""
        _demand("number of motors", len(self.motors), MOTORS, MOTORS)


@dataclass(frozen=True)
class ClearError:
    """Make a board forget a latched error; until then it ignores commands."""

    board: int  # 1-12

    def __post_init__(self) -> None:
        """Refuse a board that does not exist."""
        _demand_board(self.board)


@dataclass(frozen=True)
class FeedbackSetting:
    """When a board sends its status; the period is a multiple of 10 ms up to 2550."""

    board: int  # 1-12
    mode: FeedbackMode
    period_ms: int
    enabled: bool

    def __post_init__(self) -> None:
        """Refuse a board that does not exist and a period that one byte of 10 ms cannot hold."""
        _demand_board(self.board)
        _demand("period_ms", self.period_ms, 0, 255 * FEEDBACK_PERIOD_UNIT_MS)
        if self.period_ms % FEEDBACK_PERIOD_UNIT_MS:
            raise ValueError(f"period_ms {self.period_ms} is not a multiple of {FEEDBACK_PERIOD_UNIT_MS}")


@dataclass(frozen=True)
class NvmRead:
    """Ask a board for a value of its memory."""

    board: int  # 1-12
    address: NvmAddress

    def __post_init__(self) -> None:
        """Refuse a board that does not exist."""
        _demand_board(self.board)


def _demand_board(board: int) -> None:
    if not is_board(board):
        raise ValueError(f"board {board} does not exist")


Command = BoardMotion | ShortMotion | BroadcastMotion | ClearError | FeedbackSetting | NvmRead

"""A CAN-FD frame, its padding, and the typed refusal that decoding gives instead of an exception."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from common.dexhand021.tables import BROADCAST_MOTION, MAX_CAN_ID, Base, is_board

FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_BASE_MASK, _BOARD_MASK = 0xF80, 0x07F


@dataclass(frozen=True)
class Frame:
    """One CAN-FD frame with a standard 11-bit id; bit rate switching is the driver's business."""

    can_id: int
    data: bytes


class Reason(StrEnum):
    """Why a frame was refused; a fixed set of words, so that a counter of them stays small."""

    UNKNOWN_ID = "unknown id"
    UNKNOWN_BOARD = "unknown board"
    OTHER_DIRECTION = "other direction"
    LENGTH = "length"
    FUNCTION = "unknown function"
    ADDRESS = "unknown address"
    MODE = "unknown mode"
    VALUE = "value out of range"
    BLOCKED = "blocked function"


@dataclass(frozen=True)
class Refusal:
    """A frame that means nothing here; the caller counts it by its reason."""

    reason: Reason
    frame: Frame


def padded(frame: Frame, fill: int = 0) -> Frame:
    """Lengthen the data to the next length that CAN-FD can express, as a controller does."""
    length = next(length for length in FD_LENGTHS if length >= len(frame.data))
    return Frame(frame.can_id, frame.data + bytes([fill]) * (length - len(frame.data)))


def split_id(frame: Frame) -> tuple[int, int] | Refusal:
    """(base, board 1-12) of an id, or a refusal; the hand's side handles the two common ids itself."""
    if not 0 <= frame.can_id <= MAX_CAN_ID:
        return Refusal(Reason.UNKNOWN_ID, frame)
    board = frame.can_id & _BOARD_MASK
    if not is_board(board):
        common = frame.can_id in (BROADCAST_MOTION, Base.GLOBAL)
        return Refusal(Reason.OTHER_DIRECTION if common else Reason.UNKNOWN_BOARD, frame)
    return frame.can_id & _BASE_MASK, board

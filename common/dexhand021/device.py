"""The hand's side of the wire, for the emulator: frames to commands, replies to frames.

Written offset by offset from the byte tables and apart from `host`, so that no mistake is made twice alike.
"""

from __future__ import annotations

import math
import struct

from common.dexhand021 import tables
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
from common.dexhand021.frames import Frame, Reason, Refusal, split_id
from common.dexhand021.replies import (
    BoardFeedback,
    ConfigReply,
    ErrorReport,
    MotorFlag,
    NvmReply,
    OverTemperature,
    Reply,
    Startup,
    Tactile,
    WarningReport,
)
from common.dexhand021.tables import Base, ControlMode, FeedbackMode, Hand, NvmAddress

ERROR_BYTES = 64  # of the one error that was captured on a real hand
_BROADCAST_BYTES, _MOTION_BYTES, _SHORT_BYTES = 64, 12, 6


def decode(frame: Frame) -> Command | Refusal:
    """The command in `frame`, or a refusal; never an exception, whatever the bytes."""
    if frame.can_id == tables.BROADCAST_MOTION:
        return _broadcast(frame)
    if frame.can_id == Base.GLOBAL:
        blocked = frame.data[1:2] in [bytes([function]) for function in tables.BLOCKED_FUNCTIONS]
        return Refusal(Reason.BLOCKED if blocked else Reason.FUNCTION, frame)
    split = split_id(frame)
    if isinstance(split, Refusal):
        return split
    base, board = split
    if base == Base.MOTION:
        return _motion(frame, board)
    if base == Base.CONFIG:
        return _config(frame, board)
    known = base in (Base.CONFIG_REPLY, Base.FEEDBACK, Base.STARTUP, Base.ERROR)
    return Refusal(Reason.OTHER_DIRECTION if known else Reason.UNKNOWN_ID, frame)


def _unsigned(data: bytes, offset: int) -> int:
    return data[offset] | data[offset + 1] << 8


def _signed(data: bytes, offset: int) -> int:
    value = _unsigned(data, offset)
    return value - 0x10000 if value & 0x8000 else value


def _pair(data: bytes, offset: int, enabled: tuple[bool, bool]) -> tuple[MotorTarget, MotorTarget] | None:
    speeds = _unsigned(data, offset + 4), _unsigned(data, offset + 6)
    if max(speeds) > tables.MAX_SPEED:
        return None
    return (
        MotorTarget(enabled[0], _signed(data, offset), speeds[0], data[offset + 8]),
        MotorTarget(enabled[1], _signed(data, offset + 2), speeds[1], data[offset + 9]),
    )


def _broadcast(frame: Frame) -> BroadcastMotion | Refusal:
    data = frame.data
    if len(data) != _BROADCAST_BYTES:
        return Refusal(Reason.LENGTH, frame)
    if data[0] not in tuple(ControlMode):
        return Refusal(Reason.MODE, frame)
    if data[2] & 0x0F or data[3] & 0xF8:
        return Refusal(Reason.VALUE, frame)
    motors: list[MotorTarget] = []
    for board in range(len(tables.BOARDS)):
        byte, bit = (1, 7 - 2 * board) if board < 4 else (2, 15 - 2 * board)
        pair = _pair(data, 4 + 10 * board, (bool(data[byte] >> bit & 1), bool(data[byte] >> (bit - 1) & 1)))
        if pair is None:
            return Refusal(Reason.VALUE, frame)
        motors += pair
    return BroadcastMotion(
        hand=Hand.RIGHT if data[3] & 1 else Hand.LEFT,
        mode=ControlMode(data[0]),
        motors=tuple(motors),
        request_feedback=bool(data[3] & 2),
        clear_errors=bool(data[3] & 4),
    )


def _motion(frame: Frame, board: int) -> BoardMotion | ShortMotion | Refusal:
    data = frame.data
    if len(data) not in (_SHORT_BYTES, _MOTION_BYTES):
        return Refusal(Reason.LENGTH, frame)
    if data[0] not in tuple(ControlMode):
        return Refusal(Reason.MODE, frame)
    mode, enabled = ControlMode(data[0]), (bool(data[1] & 1), bool(data[1] & 2))
    if len(data) == _SHORT_BYTES:
        first, second = ShortTarget(enabled[0], _signed(data, 2)), ShortTarget(enabled[1], _signed(data, 4))
        return Refusal(Reason.VALUE, frame) if data[1] > 3 else ShortMotion(board, mode, (first, second))
    pair = _pair(data, 2, enabled)
    return Refusal(Reason.VALUE, frame) if data[1] > 3 or pair is None else BoardMotion(board, mode, pair)


def _config(frame: Frame, board: int) -> ClearError | FeedbackSetting | NvmRead | Refusal:
    data = frame.data
    if len(data) < 2:
        return Refusal(Reason.LENGTH, frame)
    if data[0] == tables.READ:
        known = data[1] in tuple(NvmAddress)
        return NvmRead(board, NvmAddress(data[1])) if known else Refusal(Reason.ADDRESS, frame)
    if data[0] == tables.WRITE:
        return Refusal(Reason.BLOCKED if data[1] == tables.FLASH_SAVE else Reason.FUNCTION, frame)
    if data[0] != tables.FUNCTION:
        return Refusal(Reason.FUNCTION, frame)
    return _function(frame, board)


def _function(frame: Frame, board: int) -> ClearError | FeedbackSetting | Refusal:
    data = frame.data
    if data[1] == tables.CLEAR_ERROR:
        return ClearError(board)
    if data[1] in tables.BLOCKED_FUNCTIONS:
        return Refusal(Reason.BLOCKED, frame)
    if data[1] != tables.CONFIGURE_FEEDBACK:
        return Refusal(Reason.FUNCTION, frame)
    if len(data) < 5:
        return Refusal(Reason.LENGTH, frame)
    if data[2] not in tuple(FeedbackMode) or data[4] > 1:
        return Refusal(Reason.VALUE, frame)
    period_ms = data[3] * tables.FEEDBACK_PERIOD_UNIT_MS
    return FeedbackSetting(board, FeedbackMode(data[2]), period_ms, enabled=bool(data[4]))


def encode(reply: Reply, feedback_bytes: int = tables.BYTES_IMPEDANCE) -> Frame:
    """The frame that says `reply`; a status is `feedback_bytes` long and lacks what does not fit."""
    match reply:
        case BoardFeedback():
            base, data = Base.FEEDBACK, _feedback(reply, feedback_bytes)
        case ErrorReport():
            base, data = Base.ERROR, _error(reply)
        case WarningReport(_, code):
            base, data = Base.ERROR, bytes((0xEF, code)).ljust(ERROR_BYTES, b"\0")
        case OverTemperature():
            base, data = Base.ERROR, (b"\xff" * 6).ljust(ERROR_BYTES, b"\0")
        case ConfigReply(_, function, ok):
            base, data = Base.CONFIG_REPLY, bytes((0x03, function, 0x00, 0x01 if ok else 0x00))
        case NvmReply():
            base, data = Base.CONFIG_REPLY, _nvm(reply)
        case Startup(_, raw):
            base, data = Base.STARTUP, raw
    return Frame(base + reply.board, data)


def _nvm(reply: NvmReply) -> bytes:
    return bytes((0x01, reply.address)) + reply.value.to_bytes(tables.NVM_BYTES[reply.address], "little")


def _error(report: ErrorReport) -> bytes:
    first, second = report.flags
    mask = report.affected[0] | report.affected[1] << 1
    return bytes((0xEE, mask, first | second << 4)).ljust(ERROR_BYTES, b"\0")


def _feedback(reply: BoardFeedback, length: int) -> bytes:
    data = bytearray(64)
    for motor, state in enumerate(reply.motors):
        struct.pack_into("<h", data, 6 * motor, state.current_ma)
        struct.pack_into("<h", data, 6 * motor + 2, state.speed_rpm)
        struct.pack_into("<h", data, 6 * motor + 4, state.hall_counts)
        struct.pack_into("<h", data, 12 + 2 * motor, state.angle_cdeg)
    if reply.tactile is not None:
        _put_tactile(data, reply.tactile)
    struct.pack_into("<I", data, 38, reply.temperature_c or 0)
    for motor in range(2):
        encoders, errors = reply.encoders or (0, 0), reply.errors or (MotorFlag(0), MotorFlag(0))
        impedances = reply.impedances or (0.0, 0.0)
        struct.pack_into("<H", data, 42 + 2 * motor, encoders[motor])
        struct.pack_into("<B", data, 46 + motor, errors[motor])
        struct.pack_into("<f", data, 48 + 4 * motor, _or_nan(impedances[motor]))
    return bytes(data[:length])


def _put_tactile(data: bytearray, tactile: Tactile) -> None:
    struct.pack_into("<f", data, 16, _or_nan(tactile.normal_n))
    struct.pack_into("<I", data, 20, tactile.normal_change)
    struct.pack_into("<f", data, 24, _or_nan(tactile.tangential_n))
    struct.pack_into("<I", data, 28, tactile.tangential_change)
    direction = tables.DIRECTION_INVALID if tactile.direction_deg is None else tactile.direction_deg
    struct.pack_into("<H", data, 32, direction)
    struct.pack_into("<I", data, 34, tactile.proximity)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value

"""The computer's side of the wire: commands to frames, frames to replies."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

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
)
from common.dexhand021.frames import Frame, Reason, Refusal, split_id
from common.dexhand021.replies import (
    BoardFeedback,
    ConfigReply,
    ErrorReport,
    MotorFlag,
    MotorState,
    NvmReply,
    OverTemperature,
    Reply,
    Startup,
    Tactile,
    WarningReport,
)
from common.dexhand021.tables import Base, Hand, NvmAddress

_DRIVE = struct.Struct("<hhHHBB")  # positions, speeds, currents of a board's two motors
_SHORT = struct.Struct("<hh")
_MOTORS = struct.Struct("<hhhhhhhh")  # current, speed, counts of either motor; both angles
_TACTILE = struct.Struct("<fIfIHII")  # forces with changes, direction, proximity, temperature
_ENCODERS = struct.Struct("<HH")
_IMPEDANCE = struct.Struct("<ff")
_ERROR, _WARNING, _HOT = 0xEE, 0xEF, b"\xff" * 6


def encode(command: Command) -> Frame:
    """The frame that says `command`."""
    match command:
        case BroadcastMotion():
            return Frame(tables.BROADCAST_MOTION, _broadcast(command))
        case BoardMotion(board, mode, motors):
            head = bytes((mode, _bits([motor.enabled for motor in motors])))
            return Frame(Base.MOTION + board, head + _drive(*motors))
        case ShortMotion(board, mode, motors):
            head = bytes((mode, _bits([motor.enabled for motor in motors])))
            return Frame(Base.MOTION + board, head + _SHORT.pack(motors[0].position, motors[1].position))
        case ClearError(board):
            return Frame(Base.CONFIG + board, bytes((tables.FUNCTION, tables.CLEAR_ERROR)))
        case FeedbackSetting():
            return Frame(Base.CONFIG + command.board, _feedback_setting(command))
        case NvmRead(board, address):
            return Frame(Base.CONFIG + board, bytes((tables.READ, address)))


def _bits(enabled: Sequence[bool]) -> int:
    return sum(on << bit for bit, on in enumerate(enabled))


def _drive(first: MotorTarget, second: MotorTarget) -> bytes:
    positions, speeds = (first.position, second.position), (first.speed, second.speed)
    return _DRIVE.pack(*positions, *speeds, first.current, second.current)


def _broadcast(command: BroadcastMotion) -> bytes:
    enabled = [motor.enabled for motor in command.motors]
    options = _bits((command.hand is Hand.RIGHT, command.request_feedback, command.clear_errors))
    head = bytes((command.mode, _bits(enabled[7::-1]), _bits(enabled[:7:-1]) << 4, options))
    motors = command.motors
    return head + b"".join(_drive(motors[i], motors[i + 1]) for i in range(0, tables.MOTORS, 2))


def _feedback_setting(command: FeedbackSetting) -> bytes:
    period = command.period_ms // tables.FEEDBACK_PERIOD_UNIT_MS
    return bytes((tables.FUNCTION, tables.CONFIGURE_FEEDBACK, command.mode, period, command.enabled))


def decode(frame: Frame, feedback_bytes: int | None = None) -> Reply | Refusal:
    """The reply in `frame`, or a refusal; never an exception, whatever the bytes.

    `feedback_bytes` is the status length of the hand's firmware: padding beyond it is not read. None reads
    whatever the frame is long enough for.
    """
    split = split_id(frame)
    if isinstance(split, Refusal):
        return split
    base, board = split
    if base == Base.FEEDBACK:
        return _feedback(frame, board, feedback_bytes)
    if base == Base.ERROR:
        return _error(frame, board)
    if base == Base.CONFIG_REPLY:
        return _config_reply(frame, board)
    if base == Base.STARTUP:
        return Startup(board, frame.data)
    ours = base in (Base.CONFIG, Base.MOTION)
    return Refusal(Reason.OTHER_DIRECTION if ours else Reason.UNKNOWN_ID, frame)


def _feedback(frame: Frame, board: int, feedback_bytes: int | None) -> BoardFeedback | Refusal:
    data = frame.data[:feedback_bytes]
    length = len(data)
    if length < tables.BYTES_MOTORS:
        return Refusal(Reason.LENGTH, frame)
    tactile, temperature = _tactile(data, board) if length >= tables.BYTES_TACTILE else (None, None)
    return BoardFeedback(
        board=board,
        motors=_motors(data),
        tactile=tactile,
        temperature_c=temperature,
        encoders=_ENCODERS.unpack_from(data, 42) if length >= tables.BYTES_ENCODERS else None,
        errors=(MotorFlag(data[46]), MotorFlag(data[47])) if length >= tables.BYTES_ERRORS else None,
        impedances=_impedances(data) if length >= tables.BYTES_IMPEDANCE else None,
    )


def _motors(data: bytes) -> tuple[MotorState, MotorState]:
    current1, speed1, counts1, current2, speed2, counts2, angle1, angle2 = _MOTORS.unpack_from(data)
    return MotorState(current1, speed1, counts1, angle1), MotorState(current2, speed2, counts2, angle2)


def _tactile(data: bytes, board: int) -> tuple[Tactile | None, int | None]:
    normal, normal_change, tangential, tangential_change, direction, proximity, temperature = (
        _TACTILE.unpack_from(data, 16)
    )
    _, index = tables.hand_and_board(board)
    if not tables.BOARDS[index].has_tactile:
        return None, None
    tactile = Tactile(
        normal_n=_finite(normal),
        normal_change=normal_change,
        tangential_n=_finite(tangential),
        tangential_change=tangential_change,
        direction_deg=direction if direction < 360 else None,
        proximity=proximity,
    )
    return tactile, temperature


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _impedances(data: bytes) -> tuple[float | None, float | None]:
    first, second = _IMPEDANCE.unpack_from(data, 48)
    return _finite(first), _finite(second)


def _error(frame: Frame, board: int) -> ErrorReport | WarningReport | OverTemperature | Refusal:
    data = frame.data
    if data[:6] == _HOT:
        return OverTemperature(board)
    if len(data) < 2 or (data[0] == _ERROR and len(data) < 3):
        return Refusal(Reason.LENGTH, frame)
    if data[0] == _WARNING:
        return WarningReport(board, data[1], data)
    if data[0] != _ERROR:
        return Refusal(Reason.FUNCTION, frame)
    if not 1 <= data[1] <= 3:
        return Refusal(Reason.VALUE, frame)
    affected = (bool(data[1] & 1), bool(data[1] & 2))
    return ErrorReport(board, affected, _flags(affected, data[2]), data)


def _flags(affected: tuple[bool, bool], code: int) -> tuple[MotorFlag, MotorFlag]:
    # One SDK gives motor 2 the high nibble, two others say with the mask alone whose the low nibble is:
    # an empty high nibble therefore means that the low one speaks for motor 2 as well.
    low, high = code & 0x0F, code >> 4
    return MotorFlag(low if affected[0] else 0), MotorFlag((high or low) if affected[1] else 0)


def _config_reply(frame: Frame, board: int) -> ConfigReply | NvmReply | Refusal:
    data = frame.data
    if len(data) < 2:
        return Refusal(Reason.LENGTH, frame)
    if data[0] == tables.READ:
        return _nvm_reply(frame, board)
    if data[0] != tables.FUNCTION:
        return Refusal(Reason.FUNCTION, frame)
    if len(data) < 4:
        return Refusal(Reason.LENGTH, frame)
    return ConfigReply(board, data[1], ok=data[2:4] == b"\x00\x01")


def _nvm_reply(frame: Frame, board: int) -> NvmReply | Refusal:
    if frame.data[1] not in tuple(NvmAddress):
        return Refusal(Reason.ADDRESS, frame)
    address = NvmAddress(frame.data[1])
    size = tables.NVM_BYTES[address]
    if len(frame.data) < 2 + size:
        return Refusal(Reason.LENGTH, frame)
    return NvmReply(board, address, int.from_bytes(frame.data[2 : 2 + size], "little"))

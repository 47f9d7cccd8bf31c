"""What the hand may answer, as values; None stands for what a frame did not carry or marked as invalid."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

from common.dexhand021.tables import NvmAddress


class MotorFlag(IntFlag):
    """What is wrong with a motor; bits without a name are kept, since any bit means trouble."""

    OVERLOAD = 0x01
    HALL = 0x02
    STALL = 0x04
    PARAMETER = 0x08


@dataclass(frozen=True)
class MotorState:
    """One motor as measured; the angle is its joint sensor's, the counts are its Hall sensor's."""

    current_ma: int
    speed_rpm: int
    hall_counts: int
    angle_cdeg: int  # 0.01°


@dataclass(frozen=True)
class Tactile:
    """A fingertip: forces in N, None where the sensor says NaN or "no direction"; the rest raw."""

    normal_n: float | None
    normal_change: int
    tangential_n: float | None
    tangential_change: int
    direction_deg: int | None  # 0-359, 0 towards the tip
    proximity: int


@dataclass(frozen=True)
class BoardFeedback:
    """Status of one board; a later field is None when the frame was too short for it.

    The palm board has neither fingertip sensor nor, as far as is known, a temperature.
    """

    board: int  # 1-12
    motors: tuple[MotorState, MotorState]
    tactile: Tactile | None = None
    temperature_c: int | None = None
    encoders: tuple[int, int] | None = None  # raw, 0-4095
    errors: tuple[MotorFlag, MotorFlag] | None = None
    impedances: tuple[float | None, float | None] | None = None  # raw, lower = more resistance


@dataclass(frozen=True)
class ErrorReport:
    """A board latched an error: which motors, and their flags; `raw` is the payload, for the log."""

    board: int  # 1-12
    affected: tuple[bool, bool]
    flags: tuple[MotorFlag, MotorFlag]
    raw: bytes


@dataclass(frozen=True)
class WarningReport:
    """A board warns; sources disagree whether code 1 means the Hall limit or a hot motor."""

    board: int  # 1-12
    code: int
    raw: bytes


@dataclass(frozen=True)
class OverTemperature:
    """A board is too hot: power the hand off and let it rest."""

    board: int  # 1-12


@dataclass(frozen=True)
class ConfigReply:
    """A board's answer to a configuration function."""

    board: int  # 1-12
    function: int
    ok: bool


@dataclass(frozen=True)
class NvmReply:
    """A value of a board's memory."""

    board: int  # 1-12
    address: NvmAddress
    value: int


@dataclass(frozen=True)
class Startup:
    """A board has started; the layout of its payload is not public."""

    board: int  # 1-12
    raw: bytes


Reply = BoardFeedback | ErrorReport | WarningReport | OverTemperature | ConfigReply | NvmReply | Startup

"""Messages of a real hand, or of one that is emulated down to the CAN frame; see `common.messages`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from common.message_fields import ArraySpec, Count, Float32, Range, UInt8


class PoseSource(StrEnum):
    """Who tells where the object is; exactly one in a cell."""

    TWIN = "twin"  # the physics behind the emulated hand
    PERCEPTION = "perception"


@dataclass(frozen=True)
class ObjectPose:
    """`object/pose`: the die in the palm frame; the header's t_ns is when it was seen.

    The header's `valid` is the sender's claim that it is right: from others nothing is learned.
    """

    position: Annotated[Float32, ArraySpec("<f4", (3,), "m, palm frame")]
    rotation: Annotated[Float32, ArraySpec("<f4", (4,), "quaternion wxyz, palm frame", limit=2.0)]
    covariance: Annotated[Float32, ArraySpec("<f4", (6, 6), "m² and rad², translation first")]
    quality: Annotated[float, Range(0, 1)]  # share of what should be seen that is
    label_posterior: Annotated[Float32, ArraySpec("<f4", (24,), "probability per labelling", limit=1.0)]
    source: PoseSource


class Drive(StrEnum):
    """What the driver of the hand makes the motors do."""

    OFF = "off"  # no torque; the hand only reports
    HOLD = "hold"  # stay at the present set point
    FOLLOW = "follow"  # go to the commanded action


class Link(StrEnum):
    """Whether the hand's bus can be used."""

    DOWN = "down"
    UP = "up"
    BUS_OFF = "bus_off"  # until a board has been heard again


@dataclass(frozen=True)
class HandCommand:
    """`port/hand/command`: what the driver does until the next command; its own silence ends in no torque."""

    drive: Drive
    action: Annotated[Float32, ArraySpec("<f4", ("E",), "normalised, or empty", limit=1.0)]
    duration_ns: Count  # of the way to `action`


_MOTORS = ("<f4", (12,))


@dataclass(frozen=True)
class HandFrame:
    """`port/hand`: what the hand last reported and what the driver last sent.

    12 motors, 6 boards, 5 fingertips (thumb first) in the order of common.dexhand021.tables; what is not
    valid keeps its last value, or 0 before there was one.
    """

    t_ns: Count  # when this was put together; board i was heard `age_ms[i]` before
    link: Link
    drive: Drive
    angle_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad")]
    target_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad, as sent")]
    enabled: Annotated[UInt8, ArraySpec("|u1", (12,), "motor has torque", limit=1)]
    limited: Annotated[UInt8, ArraySpec("|u1", (12,), "target is not what was asked for", limit=1)]
    current_ma: Annotated[Float32, ArraySpec(*_MOTORS, "mA")]
    flags: Annotated[UInt8, ArraySpec("|u1", (12,), "error bits of a motor", limit=255)]
    force_n: Annotated[Float32, ArraySpec("<f4", (5,), "N, normal force")]
    force_valid: Annotated[UInt8, ArraySpec("|u1", (5,), "0 or 1", limit=1)]
    temperature_c: Annotated[Float32, ArraySpec("<f4", (6,), "°C")]
    temperature_valid: Annotated[UInt8, ArraySpec("|u1", (6,), "0 or 1", limit=1)]
    age_ms: Annotated[Float32, ArraySpec("<f4", (6,), "ms since a board was heard; 1e6: never")]
    rate_hz: Annotated[Float32, ArraySpec("<f4", (6,), "replies a second")]
    overheated: Annotated[UInt8, ArraySpec("|u1", (6,), "board said so and is not cool again", limit=1)]
    counts: dict[str, float]  # what the driver and the limits count
    error: str  # why there is no bus; empty while there is one


@dataclass(frozen=True)
class HandJoints:
    """`hand/joints`: a real hand for people; shapes and order as in HandFrame."""

    state: str  # of the arming
    faults: tuple[str, ...]
    q_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad")]
    target_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad, as sent")]
    current_ma: Annotated[Float32, ArraySpec(*_MOTORS, "mA")]
    flags: Annotated[UInt8, ArraySpec("|u1", (12,), "error bits of a motor", limit=255)]
    force_n: Annotated[Float32, ArraySpec("<f4", (5,), "N, normal force")]
    force_valid: Annotated[UInt8, ArraySpec("|u1", (5,), "0 or 1", limit=1)]
    temperature_c: Annotated[Float32, ArraySpec("<f4", (6,), "°C")]
    temperature_valid: Annotated[UInt8, ArraySpec("|u1", (6,), "0 or 1", limit=1)]
    board_age_ms: Annotated[Float32, ArraySpec("<f4", (6,), "ms since a board was heard")]
    board_rate_hz: Annotated[Float32, ArraySpec("<f4", (6,), "replies a second")]


@dataclass(frozen=True)
class TwinCommand:
    """`port/twin/command`: what the person beside an emulated hand does."""

    lay_die: bool  # into the hand, as episodes begin


@dataclass(frozen=True)
class TwinFrame:
    """`port/twin`: the truth behind an emulated hand, for those who look after it."""

    t_ns: Count
    position: Annotated[Float32, ArraySpec("<f4", (3,), "m, of the die, palm frame")]
    rotation: Annotated[Float32, ArraySpec("<f4", (4,), "quaternion wxyz, palm frame", limit=2.0)]
    holding: bool
    q_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad")]
    powered: Annotated[UInt8, ArraySpec("|u1", (12,), "motor has torque", limit=1)]
    counts: dict[str, float]


class ArmWish(StrEnum):
    """What a person may ask of a real hand."""

    ARM = "arm"
    DISARM = "disarm"
    STATUS = "status"


@dataclass(frozen=True)
class ArmRequest:
    """`port/arm`: a person's wish, as it came in with the query `hand/arm`."""

    wish: ArmWish
    deadline_ns: Count = 0  # set by the desk: after it the person has been told that nobody answers


@dataclass(frozen=True)
class ArmReply:
    """`port/arm/reply`: the answer to that query."""

    accepted: bool
    state: str
    reason: str

"""Joints, boards, CAN ids, ranges and scales of the DexHand 021 as data.

Facts from DexRobot's public SDKs (pyzlg_dexhand, dexhand_sdk_cpp) and models (dexrobot_urdf,
dexrobot_mujoco, Apache-2.0); where they differ, both values stand here. Motor order is board order, so
motor i sits on board i // 2 and is that board's motor i % 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray


class Hand(StrEnum):
    """Which hand; its boards have ids 1-6 (left) or 7-12 (right)."""

    LEFT = "left"
    RIGHT = "right"


class Base(IntEnum):
    """CAN ids are base + board; BROADCAST_MOTION is an id of its own, GLOBAL is never sent."""

    CONFIG = 0x000
    CONFIG_REPLY = 0x080
    GLOBAL = 0x0FF
    MOTION = 0x100
    FEEDBACK = 0x180
    STARTUP = 0x400
    ERROR = 0x600


BROADCAST_MOTION = 0x100
MAX_CAN_ID = 0x7FF  # 11 bits: a vendor document says "extended", its code sends standard frames


class ControlMode(IntEnum):
    """How a motor follows its set point; the angle modes take hundredths of a degree, Hall modes counts."""

    ZERO_TORQUE = 0x00
    CURRENT = 0x11
    SPEED = 0x22
    HALL_POSITION = 0x33
    CASCADED_PID = 0x44
    PROTECTED_HALL_POSITION = 0x55
    MIT_TORQUE = 0x66
    IMPEDANCE_GRASP = 0x77


class FeedbackMode(IntEnum):
    """When a board sends its status without being commanded."""

    PERIODIC = 1
    QUERY = 2
    ON_CHANGE = 3


class NvmAddress(IntEnum):
    """What may be read from a board's memory; 0x04 saves to flash and is left out, as are all writes."""

    BOARD_ID = 0x01
    FIRMWARE = 0x02
    STALL_TIME_1_MS = 0x50
    STALL_TIME_2_MS = 0x51
    SAFE_TEMPERATURE_C = 0x54


NVM_BYTES = {
    NvmAddress.BOARD_ID: 1,
    NvmAddress.FIRMWARE: 2,
    NvmAddress.STALL_TIME_1_MS: 2,
    NvmAddress.STALL_TIME_2_MS: 2,
    NvmAddress.SAFE_TEMPERATURE_C: 1,
}

# First byte of a configuration frame, and the functions that this code knows how to ask for.
READ, WRITE, FUNCTION = 0x01, 0x02, 0x03
CONFIGURE_FEEDBACK, CLEAR_ERROR = 0x74, 0xA4
# Never sent: CAN type switch, factory reset, firmware upgrade; and the memory address that saves to flash.
BLOCKED_FUNCTIONS = (0x70, 0x71, 0x76)
FLASH_SAVE = 0x04


@dataclass(frozen=True)
class Board:
    """One of six driver boards with two motors each; the palm's has no fingertip sensor."""

    name: str
    has_tactile: bool


BOARDS = (
    Board("thumb", True),
    Board("palm", False),
    Board("index", True),
    Board("middle", True),
    Board("ring", True),
    Board("little", True),
)


@dataclass(frozen=True)
class Joint:
    """One motor: names of SDK and paper (or by analogy to it), ranges of SDK (°) and model (rad).

    Both ranges begin at 0; positive is flexion, opposition or spreading. `hall_scale` converts degrees to
    Hall counts, see HALL_COUNTS_PER_DEG.
    """

    name: str
    paper_name: str
    sdk_high_deg: float
    model_high_rad: float
    hall_scale: float

    @property
    def high_cdeg(self) -> int:
        """Upper end of the narrower range, rounded down to the wire's 0.01°: rounding never leaves it."""
        return math.floor(100.0 * min(self.sdk_high_deg, math.degrees(self.model_high_rad)))


JOINTS = (
    Joint("th_dip", "Thumb DIP", 90.0, 1.3, 2.1),
    Joint("th_mcp", "Thumb MCP", 90.0, 1.3, 2.1),
    Joint("th_rot", "Thumb Rot", 150.0, 2.2, 1.8),
    Joint("ff_spr", "Finger spread", 30.0, 0.3, 4.0),
    Joint("ff_dip", "FF PIP", 90.0, 1.3, 2.2),
    Joint("ff_mcp", "FF MCP", 90.0, 1.3, 1.6),
    Joint("mf_dip", "MF PIP", 90.0, 1.3, 2.2),
    Joint("mf_mcp", "MF MCP", 90.0, 1.3, 1.6),
    Joint("rf_dip", "RF PIP", 90.0, 1.3, 2.2),
    Joint("rf_mcp", "RF MCP", 90.0, 1.3, 1.6),
    Joint("lf_dip", "LF PIP", 90.0, 1.3, 2.2),
    Joint("lf_mcp", "LF MCP", 90.0, 1.3, 1.6),
)

MOTORS = len(JOINTS)
LOW_RAD: NDArray[np.float64] = np.zeros(MOTORS)
HIGH_RAD: NDArray[np.float64] = np.radians([joint.high_cdeg / 100.0 for joint in JOINTS])
LOW_RAD.setflags(write=False)
HIGH_RAD.setflags(write=False)

# 6 counts a motor turn, gear 25, 16 / 360 turns a degree; times the joint's hall_scale.
HALL_COUNTS_PER_DEG = 6 * 25 * 16 / 360
ENCODER_COUNTS_PER_DEG = 4096 / 360

MAX_POSITION = 32767  # i16
MAX_SPEED = 32767  # the SDK's bound, in a u16
MAX_CURRENT = 255  # one byte on the wire, whatever the vendor's validator accepts
FEEDBACK_PERIOD_UNIT_MS = 10

# Length of a status frame at which each part is complete; firmware has grown it over the years.
BYTES_MOTORS, BYTES_TACTILE, BYTES_ENCODERS, BYTES_ERRORS, BYTES_IMPEDANCE = 16, 42, 46, 48, 56
DIRECTION_INVALID = 0xFFFF

# Links of a finger from its spread axis: knuckle offset, to PIP, to DIP, to the tip; distance of neighbours.
FINGER_LINKS_M = (0.017, 0.043, 0.025, 0.035)
FINGER_PITCH_M = 0.0243
FINGER_RADIUS_M = 0.0095


def board_id(hand: Hand, board: int) -> int:
    """Id 1-12 of board 0-5 (order of BOARDS) of a hand."""
    return board + (1 if hand is Hand.LEFT else 1 + len(BOARDS))


def hand_and_board(identity: int) -> tuple[Hand, int]:
    """The hand and board 0-5 of an id 1-12, the inverse of `board_id`."""
    hand = Hand.LEFT if identity <= len(BOARDS) else Hand.RIGHT
    return hand, (identity - 1) % len(BOARDS)


def is_board(identity: int) -> bool:
    """Tell whether a board has this id."""
    return 1 <= identity <= 2 * len(BOARDS)

"""Frames written out by hand from the documented byte tables, and what they mean: neither codec made them."""

from __future__ import annotations

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
from common.dexhand021.frames import Frame
from common.dexhand021.replies import (
    BoardFeedback,
    ConfigReply,
    ErrorReport,
    MotorFlag,
    MotorState,
    NvmReply,
    OverTemperature,
    Reply,
    Tactile,
    WarningReport,
)
from common.dexhand021.tables import ControlMode, FeedbackMode, Hand, NvmAddress


def frame(can_id: int, text: str) -> Frame:
    return Frame(can_id, bytes.fromhex(text))


def target(index: int) -> MotorTarget:
    speed = 1000 if index % 2 == 0 else 2000
    return MotorTarget(index in (0, 7, 8), 100 * (index + 1), speed, 10 + index)


COMMANDS: list[tuple[Frame, Command]] = [
    (
        # Right index: both motors, 45.00 and -20.00 degrees, speeds 15000 and 300, currents 20 and 200.
        frame(0x109, "44 03 9411 30F8 983A 2C01 14 C8"),
        BoardMotion(
            9,
            ControlMode.CASCADED_PID,
            (MotorTarget(True, 4500, 15000, 20), MotorTarget(True, -2000, 300, 200)),
        ),
    ),
    (
        # The SDK's own test of its 6-byte command, left thumb.
        frame(0x101, "44 03 E803 30F8"),
        ShortMotion(1, ControlMode.CASCADED_PID, (ShortTarget(True, 1000), ShortTarget(True, -2000))),
    ),
    (
        # Left ring, motor 2 (proximal) alone.
        frame(0x105, "66 02 0000 0100 0000 FF7F 00 FF"),
        BoardMotion(
            5, ControlMode.MIT_TORQUE, (MotorTarget(False, 0, 0, 0), MotorTarget(True, 1, 32767, 255))
        ),
    ),
    (
        # Right hand, th_dip (bit 7), mf_mcp (bit 0) and rf_dip (bit 7 of byte 2) enabled, feedback requested.
        frame(
            0x100,
            "77 81 80 03"
            "6400 C800 E803 D007 0A 0B"
            "2C01 9001 E803 D007 0C 0D"
            "F401 5802 E803 D007 0E 0F"
            "BC02 2003 E803 D007 10 11"
            "8403 E803 E803 D007 12 13"
            "4C04 B004 E803 D007 14 15",
        ),
        BroadcastMotion(Hand.RIGHT, ControlMode.IMPEDANCE_GRASP, tuple(target(i) for i in range(12))),
    ),
    (frame(0x009, "03 A4"), ClearError(9)),
    (frame(0x001, "03 74 01 32 01"), FeedbackSetting(1, FeedbackMode.PERIODIC, 500, True)),
    (frame(0x00C, "03 74 02 00 00"), FeedbackSetting(12, FeedbackMode.QUERY, 0, False)),
    (frame(0x00C, "01 02"), NvmRead(12, NvmAddress.FIRMWARE)),
]

# Bytes 1 and 2 of a broadcast that enables one motor alone, in the order of the documented bits.
ENABLE_BYTES = [
    *((0x80, 0), (0x40, 0), (0x20, 0), (0x10, 0), (0x08, 0), (0x04, 0), (0x02, 0), (0x01, 0)),
    *((0, 0x80), (0, 0x40), (0, 0x20), (0, 0x10)),
]

# One status in full; a shorter frame is its beginning.
STATUS = bytes.fromhex(
    "6400 C800 E803"  # 100 mA, 200 rpm, 1000 counts
    "6AFF 06FF 30F8"  # -150 mA, -250 rpm, -2000 counts
    "9411 D8DC"  # 45.00 and -90.00 degrees
    "0000C03F 64000000"  # 1.5 N normal, change 100
    "0000003F 32000000"  # 0.5 N tangential, change 50
    "B400 F4010000 19000000"  # 180 degrees, proximity 500, 25 °C
    "0008 0004"  # encoders 2048 and 1024
    "04 01"  # motor 1 stall, motor 2 overload
    "00000040 0000803E"  # impedances 2.0 and 0.25
    "0000000000000000"  # padding to 64
)
MOTORS = (MotorState(100, 200, 1000, 4500), MotorState(-150, -250, -2000, -9000))
TACTILE = Tactile(1.5, 100, 0.5, 50, 180, 500)
ERRORS = (MotorFlag.STALL, MotorFlag.OVERLOAD)
SHORT = BoardFeedback(9, MOTORS)
TOUCH = BoardFeedback(9, MOTORS, TACTILE, 25)
ENCODED = BoardFeedback(9, MOTORS, TACTILE, 25, (2048, 1024))
FLAGGED = BoardFeedback(9, MOTORS, TACTILE, 25, (2048, 1024), ERRORS)
FULL = BoardFeedback(9, MOTORS, TACTILE, 25, (2048, 1024), ERRORS, (2.0, 0.25))

FEEDBACKS: dict[int, BoardFeedback] = {16: SHORT, 42: TOUCH, 46: ENCODED, 48: FLAGGED, 56: FULL, 64: FULL}

# The one error captured on a real hand (pyzlg_dexhand, test of its protocol): right index, motor 1 stalled.
CAPTURE = frame(0x609, "EE 01 04" + "00" * 61)
HOT = frame(0x607, "FF FF FF FF FF FF" + "00" * 58)
WARNING = frame(0x602, "EF 01" + "00" * 62)
BOTH = frame(
    0x60A, "EE 03 21" + "00" * 61
)  # motor 1 overload in the low nibble, motor 2 Hall in the high one

REPLIES: list[tuple[Frame, Reply]] = [
    (CAPTURE, ErrorReport(9, (True, False), (MotorFlag.STALL, MotorFlag(0)), CAPTURE.data)),
    (BOTH, ErrorReport(10, (True, True), (MotorFlag.OVERLOAD, MotorFlag.HALL), BOTH.data)),
    (HOT, OverTemperature(7)),
    (WARNING, WarningReport(2, 1, WARNING.data)),
    (frame(0x089, "03 A4 00 01"), ConfigReply(9, 0xA4, ok=True)),
    (frame(0x081, "03 74 00 00"), ConfigReply(1, 0x74, ok=False)),
    (frame(0x08C, "01 02 4A 63"), NvmReply(12, NvmAddress.FIRMWARE, 25418)),
    (frame(0x087, "01 54 37"), NvmReply(7, NvmAddress.SAFE_TEMPERATURE_C, 55)),
    (frame(0x088, "01 51 E8 03"), NvmReply(8, NvmAddress.STALL_TIME_2_MS, 1000)),
]

"""The computer's side of the wire against frames written by hand."""

from __future__ import annotations

import ast
import inspect
from typing import get_args

import pytest
from hypothesis import given, settings

from common.dexhand021 import host, tables
from common.dexhand021.commands import BroadcastMotion, Command, MotorTarget
from common.dexhand021.frames import FD_LENGTHS, Frame, Reason, Refusal
from common.dexhand021.replies import BoardFeedback, ErrorReport, MotorFlag, Reply, Startup
from common.dexhand021.tables import ControlMode, Hand
from tests.unit.common.dexhand021 import strategies, vectors


@pytest.mark.parametrize(("wire", "command"), vectors.COMMANDS)
def test_a_command_becomes_the_documented_bytes(wire: Frame, command: Command) -> None:
    assert host.encode(command) == wire


@pytest.mark.parametrize(("motor", "expected"), list(enumerate(vectors.ENABLE_BYTES)))
def test_each_motor_has_its_enable_bit(motor: int, expected: tuple[int, int]) -> None:
    targets = tuple(MotorTarget(index == motor, 0) for index in range(12))
    data = host.encode(BroadcastMotion(Hand.LEFT, ControlMode.CASCADED_PID, targets, False, False)).data
    assert (data[1], data[2], data[3]) == (*expected, 0)


@pytest.mark.parametrize(
    ("hand", "feedback", "clear", "byte"),
    [
        (Hand.LEFT, False, False, 0),
        (Hand.RIGHT, False, False, 1),
        (Hand.LEFT, True, False, 2),
        (Hand.LEFT, False, True, 4),
    ],
)
def test_the_options_of_a_broadcast(hand: Hand, feedback: bool, clear: bool, byte: int) -> None:
    targets = tuple(MotorTarget(False, 0) for _ in range(12))
    assert (
        host.encode(BroadcastMotion(hand, ControlMode.ZERO_TORQUE, targets, feedback, clear)).data[3] == byte
    )


@pytest.mark.parametrize("length", vectors.FEEDBACKS)
def test_a_status_is_read_as_far_as_it_goes(length: int) -> None:
    assert host.decode(Frame(0x189, vectors.STATUS[:length])) == vectors.FEEDBACKS[length]


def test_padding_is_not_read_when_the_firmware_is_known() -> None:
    padded = Frame(0x189, vectors.STATUS[:42] + b"\xcc" * 6)
    assert host.decode(padded, feedback_bytes=42) == vectors.TOUCH
    assert host.decode(padded) != vectors.TOUCH


def test_nan_and_no_direction_are_none_and_never_zero() -> None:
    data = bytearray(vectors.STATUS[:56])
    data[16:20] = bytes.fromhex("0000C07F")  # NaN
    data[24:28] = bytes.fromhex("0000807F")  # infinity
    data[32:34] = b"\xff\xff"
    data[48:52] = bytes.fromhex("0000C0FF")
    reply = host.decode(Frame(0x189, bytes(data)))
    assert isinstance(reply, BoardFeedback) and reply.tactile is not None
    tactile = reply.tactile
    assert (tactile.normal_n, tactile.tangential_n, tactile.direction_deg) == (None, None, None)
    assert reply.impedances == (None, 0.25)


@pytest.mark.parametrize("board", [2, 8])
def test_the_palm_has_no_fingertip(board: int) -> None:
    reply = host.decode(Frame(0x180 + board, vectors.STATUS))
    assert isinstance(reply, BoardFeedback)
    assert (reply.tactile, reply.temperature_c, reply.encoders) == (None, None, (2048, 1024))


@pytest.mark.parametrize(("wire", "reply"), vectors.REPLIES)
def test_replies_mean_what_is_documented(wire: Frame, reply: Reply) -> None:
    assert host.decode(wire) == reply


@pytest.mark.parametrize(
    ("code", "flags"), [("02 04", (0, 4)), ("02 40", (0, 4)), ("03 04", (4, 4)), ("01 F0", (0, 0))]
)
def test_both_documented_forms_of_motor_2_s_flags_are_read(code: str, flags: tuple[int, int]) -> None:
    reply = host.decode(vectors.frame(0x609, "EE" + code))
    assert isinstance(reply, ErrorReport)
    assert reply.flags == (MotorFlag(flags[0]), MotorFlag(flags[1]))


def test_a_start_up_keeps_its_bytes() -> None:
    assert host.decode(Frame(0x403, b"\x01\x02")) == Startup(3, b"\x01\x02")


@pytest.mark.parametrize(
    ("can_id", "text", "reason"),
    [
        (0x18D, "00" * 64, Reason.UNKNOWN_BOARD),
        (0x180, "00" * 64, Reason.UNKNOWN_BOARD),
        (0x308, "00" * 8, Reason.UNKNOWN_ID),
        (0x12345, "00" * 8, Reason.UNKNOWN_ID),
        (-1, "", Reason.UNKNOWN_ID),
        (0x109, "00" * 12, Reason.OTHER_DIRECTION),
        (0x009, "03 A4", Reason.OTHER_DIRECTION),
        (0x100, "00" * 64, Reason.OTHER_DIRECTION),
        (0x0FF, "03 70", Reason.OTHER_DIRECTION),
        (0x189, "00" * 15, Reason.LENGTH),
        (0x609, "EE", Reason.LENGTH),
        (0x609, "EE 01", Reason.LENGTH),
        (0x609, "EE 00 04", Reason.VALUE),
        (0x609, "EE 04 04", Reason.VALUE),
        (0x609, "FF FF FF FF FF 00", Reason.FUNCTION),
        (0x089, "03", Reason.LENGTH),
        (0x089, "03 A4 00", Reason.LENGTH),
        (0x089, "02 50 00 00 01", Reason.FUNCTION),
        (0x089, "01 04 00", Reason.ADDRESS),
        (0x089, "01 02 4A", Reason.LENGTH),
    ],
)
def test_what_means_nothing_is_refused_by_reason(can_id: int, text: str, reason: Reason) -> None:
    wire = vectors.frame(can_id, text)
    assert host.decode(wire) == Refusal(reason, wire)


@given(strategies.FRAMES)
@settings(max_examples=600, deadline=None)
def test_any_bytes_decode_to_a_reply_or_a_refusal(wire: Frame) -> None:
    assert isinstance(host.decode(wire), (*get_args(Reply), Refusal))


def _blocked(wire: Frame) -> bool:
    config = 0x001 <= wire.can_id <= 0x00C
    function = config and wire.data[0] == 3 and wire.data[1] in (0x70, 0x71, 0x76)
    return wire.can_id == 0x0FF or function or (config and wire.data[0] == 2)


@given(strategies.COMMANDS)
@settings(max_examples=400, deadline=None)
def test_no_command_is_a_blocked_function_or_a_memory_write(command: Command) -> None:
    wire = host.encode(command)
    assert not _blocked(wire)
    assert wire.can_id == 0x100 or (wire.can_id & 0xF80) in (0x000, 0x100)
    assert len(wire.data) in FD_LENGTHS


def test_the_host_cannot_even_name_what_is_blocked() -> None:
    tree = ast.parse(inspect.getsource(host))
    names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    numbers = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    assert not names & {"WRITE", "GLOBAL", "FLASH_SAVE", "BLOCKED_FUNCTIONS"}
    assert not numbers & {*tables.BLOCKED_FUNCTIONS, int(tables.Base.GLOBAL)}
    assert tables.FLASH_SAVE not in tuple(tables.NvmAddress)

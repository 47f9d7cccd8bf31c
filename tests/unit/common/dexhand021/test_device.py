"""The hand's side of the wire against frames written by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given, settings

from common.dexhand021 import device
from common.dexhand021.commands import BroadcastMotion, Command
from common.dexhand021.frames import Frame, Reason, Refusal, padded
from common.dexhand021.replies import Reply, Startup
from tests.unit.common.dexhand021 import strategies, vectors


@pytest.mark.parametrize(("wire", "command"), vectors.COMMANDS)
def test_the_documented_bytes_become_the_command(wire: Frame, command: Command) -> None:
    assert device.decode(wire) == command


@pytest.mark.parametrize(("motor", "enable"), list(enumerate(vectors.ENABLE_BYTES)))
def test_each_motor_has_its_enable_bit(motor: int, enable: tuple[int, int]) -> None:
    command = device.decode(Frame(0x100, bytes((0x44, *enable, 0)) + bytes(60)))
    assert isinstance(command, BroadcastMotion)
    assert [target.enabled for target in command.motors] == [index == motor for index in range(12)]


@pytest.mark.parametrize(
    ("byte", "options"),
    [
        (0, ("left", False, False)),
        (1, ("right", False, False)),
        (2, ("left", True, False)),
        (4, ("left", False, True)),
    ],
)
def test_the_options_of_a_broadcast(byte: int, options: tuple[str, bool, bool]) -> None:
    command = device.decode(Frame(0x100, bytes((0, 0, 0, byte)) + bytes(60)))
    assert isinstance(command, BroadcastMotion)
    assert (command.hand.value, command.request_feedback, command.clear_errors) == options


@pytest.mark.parametrize("length", vectors.FEEDBACKS)
def test_a_status_has_the_documented_bytes_at_every_length(length: int) -> None:
    assert device.encode(vectors.FULL, length) == Frame(0x189, vectors.STATUS[:length])


def test_invalid_readings_have_the_documented_bytes() -> None:
    broken = replace(vectors.TACTILE, normal_n=None, tangential_n=None, direction_deg=None)
    data = device.encode(replace(vectors.FULL, tactile=broken, impedances=(None, 0.25))).data
    assert data[16:20] == data[24:28] == data[48:52] == bytes.fromhex("0000C07F")
    assert data[32:34] == b"\xff\xff"


def test_what_a_board_lacks_is_zero() -> None:
    assert device.encode(replace(vectors.SHORT, board=8), 64).data == vectors.STATUS[:16] + bytes(48)


@pytest.mark.parametrize(("wire", "reply"), vectors.REPLIES)
def test_replies_have_the_documented_bytes(wire: Frame, reply: Reply) -> None:
    assert device.encode(reply) == wire


def test_a_start_up_keeps_its_bytes() -> None:
    assert device.encode(Startup(3, b"\x01\x02")) == Frame(0x403, b"\x01\x02")


MOTION = "00 0000 0000 0000 0000 00 00"


@pytest.mark.parametrize(
    ("can_id", "text", "reason"),
    [
        (0x0FF, "03 70 00 00 00 00 00 00", Reason.BLOCKED),
        (0x0FF, "03 71", Reason.BLOCKED),
        (0x0FF, "03 76", Reason.BLOCKED),
        (0x0FF, "03 75", Reason.FUNCTION),
        (0x0FF, "", Reason.FUNCTION),
        (0x009, "03 70", Reason.BLOCKED),
        (0x009, "03 71", Reason.BLOCKED),
        (0x009, "03 76", Reason.BLOCKED),
        (0x009, "02 04 00 00 00 00 00 00", Reason.BLOCKED),
        (0x009, "02 54 50 00 00 00 00 00", Reason.FUNCTION),
        (0x009, "04 00", Reason.FUNCTION),
        (0x009, "03 A2", Reason.FUNCTION),
        (0x009, "03", Reason.LENGTH),
        (0x009, "03 74 01 32", Reason.LENGTH),
        (0x009, "03 74 04 32 01", Reason.VALUE),
        (0x009, "03 74 01 32 02", Reason.VALUE),
        (0x009, "01 04", Reason.ADDRESS),
        (0x109, "44 04" + MOTION[2:], Reason.VALUE),
        (0x109, "44 04 0000 0000", Reason.VALUE),
        (0x109, "44 03 0000 0000 0080 0000 00 00", Reason.VALUE),
        (0x109, "45 03 0000 0000", Reason.MODE),
        (0x109, "44 03 0000", Reason.LENGTH),
        (0x100, "44" + "00" * 62, Reason.LENGTH),
        (0x100, "45" + "00" * 63, Reason.MODE),
        (0x100, "44 00 08 00" + "00" * 60, Reason.VALUE),
        (0x100, "44 00 00 08" + "00" * 60, Reason.VALUE),
        (0x100, "44 00 00 00 0000 0000 0000 0080" + "00" * 52, Reason.VALUE),
        (0x10D, "44 03 0000 0000", Reason.UNKNOWN_BOARD),
        (0x189, "00" * 64, Reason.OTHER_DIRECTION),
        (0x689, "00" * 8, Reason.UNKNOWN_ID),
        (0x800, "00" * 8, Reason.UNKNOWN_ID),
    ],
)
def test_what_means_nothing_is_refused_by_reason(can_id: int, text: str, reason: Reason) -> None:
    wire = vectors.frame(can_id, text)
    assert device.decode(wire) == Refusal(reason, wire)


@given(strategies.FRAMES)
@settings(max_examples=600, deadline=None)
def test_any_bytes_decode_to_a_command_or_a_refusal(wire: Frame) -> None:
    assert isinstance(device.decode(wire), (*get_args(Command), Refusal))


def test_padding_goes_to_the_next_length_of_can_fd() -> None:
    lengths = {0: 0, 8: 8, 9: 12, 16: 16, 42: 48, 46: 48, 48: 48, 56: 64, 64: 64}
    assert {n: len(padded(Frame(1, bytes(n))).data) for n in lengths} == lengths
    assert padded(Frame(1, b"\x01" * 9), fill=0xCC).data == b"\x01" * 9 + b"\xcc" * 3

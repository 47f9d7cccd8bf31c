"""What one side says the other understands; values and tables are what they claim."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings

from common.config import ConfigError, parse
from common.dexhand021 import angles, device, host, tables
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
from common.dexhand021.config import DexHandConfig
from common.dexhand021.frames import padded
from common.dexhand021.replies import Reply
from common.dexhand021.tables import ControlMode, FeedbackMode, Hand, NvmAddress
from tests.unit.common.dexhand021 import strategies, vectors


@given(strategies.COMMANDS)
@settings(max_examples=400, deadline=None)
def test_commands_arrive_as_they_were_sent(command: Command) -> None:
    assert device.decode(host.encode(command)) == command


@given(strategies.REPLIES)
@settings(max_examples=400, deadline=None)
def test_replies_arrive_as_they_were_sent(reply: Reply) -> None:
    assert host.decode(padded(device.encode(reply))) == reply


@pytest.mark.parametrize(("_wire", "reply"), vectors.REPLIES)
def test_errors_arrive_as_they_were_sent(_wire: object, reply: Reply) -> None:
    assert host.decode(device.encode(reply)) == reply


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: MotorTarget(True, 32768),
        lambda: MotorTarget(True, -32769),
        lambda: MotorTarget(True, 0, speed=32768),
        lambda: MotorTarget(True, 0, speed=-1),
        lambda: MotorTarget(True, 0, current=256),
        lambda: MotorTarget(True, 0, current=-1),
        lambda: ShortTarget(True, 32768),
        lambda: BoardMotion(0, ControlMode.CASCADED_PID, (MotorTarget(True, 0),) * 2),
        lambda: ShortMotion(13, ControlMode.CASCADED_PID, (ShortTarget(True, 0),) * 2),
        lambda: BroadcastMotion(Hand.LEFT, ControlMode.CASCADED_PID, (MotorTarget(True, 0),) * 11),
        lambda: ClearError(0),
        lambda: NvmRead(13, NvmAddress.FIRMWARE),
        lambda: FeedbackSetting(13, FeedbackMode.QUERY, 0, True),
        lambda: FeedbackSetting(1, FeedbackMode.PERIODIC, 2560, True),
        lambda: FeedbackSetting(1, FeedbackMode.PERIODIC, 15, True),
    ],
)
def test_what_the_wire_cannot_carry_cannot_be_said(wrong) -> None:
    with pytest.raises(ValueError, match=r"outside|exist|multiple"):
        wrong()


def test_boards_and_ids_belong_together() -> None:
    left = [tables.board_id(Hand.LEFT, board) for board in range(6)]
    right = [tables.board_id(Hand.RIGHT, board) for board in range(6)]
    assert (left, right) == ([1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 12])
    for hand, ids in ((Hand.LEFT, left), (Hand.RIGHT, right)):
        assert [tables.hand_and_board(identity) for identity in ids] == [(hand, board) for board in range(6)]


def test_the_narrower_range_is_taken_and_survives_the_wire() -> None:
    narrow = [7448, 7448, 12605, 1718, *[7448] * 8]  # of 90/74.5, 150/126, 30/17.2 degrees
    assert [joint.high_cdeg for joint in tables.JOINTS] == narrow
    assert angles.to_wire_cdeg(tables.HIGH_RAD).tolist() == narrow
    assert all(np.radians(joint.high_cdeg / 100) <= joint.model_high_rad for joint in tables.JOINTS)


def test_normalised_actions_span_the_range() -> None:
    for action, expected in ((-1.0, tables.LOW_RAD), (0.0, tables.HIGH_RAD / 2), (1.0, tables.HIGH_RAD)):
        assert np.allclose(angles.to_radians(np.full(12, action, np.float32)), expected, atol=1e-12)
        assert np.allclose(angles.to_normalised(expected), action, atol=1e-6)
    assert np.isnan(angles.to_radians(np.full((3, 12), np.nan))).all()
    assert angles.to_normalised(2 * tables.HIGH_RAD).dtype == np.float32
    assert np.allclose(angles.to_normalised(2 * tables.HIGH_RAD), 3.0)


def test_angles_on_the_wire() -> None:
    signs = np.array([1, -1] * 6)
    wire = angles.to_wire_cdeg(np.full(12, math.pi / 4), signs)
    assert wire.tolist() == [4500, -4500] * 6
    assert np.allclose(angles.from_wire_cdeg(wire, signs), math.pi / 4)
    with pytest.raises(ValueError, match="not finite"):
        angles.to_wire_cdeg(np.full(12, np.nan))


def test_hall_counts_follow_the_documented_scales() -> None:
    # 90 degrees: 90 x scale x 6.667, scales 2.1, 2.1, 1.8, 4.0 and 2.2, 1.6 per finger.
    expected = [1260, 1260, 1080, 2400, *[1320, 960] * 4]
    assert angles.to_hall_counts(np.full(12, math.pi / 2)).tolist() == expected


def test_a_cell_s_yaml_configures_the_hand() -> None:
    data = {"hand": "left", "signs": [-1] * 12, "feedback_bytes": 42, "mode": "impedance_grasp"}
    config = parse(DexHandConfig, data, "cell.yaml")
    assert DexHandConfig().control_mode is ControlMode.CASCADED_PID
    assert (config.hand, config.control_mode) == (Hand.LEFT, ControlMode.IMPEDANCE_GRASP)
    for wrong in ({"current": 256}, {"signs": [1] * 11}, {"signs": [0] * 12}, {"mode": "hall_position"}):
        with pytest.raises(ConfigError):
            parse(DexHandConfig, wrong, "cell.yaml")

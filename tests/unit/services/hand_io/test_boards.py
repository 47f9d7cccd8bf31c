import numpy as np
import pytest

from common.dexhand021.commands import ClearError
from common.dexhand021.config import DexHandConfig
from common.dexhand021.replies import (
    BoardFeedback,
    ErrorReport,
    MotorFlag,
    MotorState,
    OverTemperature,
    Startup,
    Tactile,
    WarningReport,
)
from services.hand_io.boards import Boards

MS = 1_000_000
NONE = MotorFlag(0)


def status(board=9, cdeg=(3000, 2000), force=1.5, temperature=30, errors=(NONE, NONE)):
    motors = tuple(MotorState(10, 0, 0, angle) for angle in cdeg)
    tactile = None if board in (2, 8) else Tactile(force, 0, 0.0, 0, None, 0)
    return BoardFeedback(board, motors, tactile, None if board in (2, 8) else temperature, None, errors)


@pytest.fixture
def boards():
    return Boards(DexHandConfig(), 100 * MS, 400 * MS, 45.0, 1000 * MS)


def test_a_status_is_told_in_our_units(boards):
    assert boards.take(0, status()) == 2
    assert np.degrees(boards.angle_rad[4:6]) == pytest.approx([30, 20])
    assert np.isnan(np.delete(boards.angle_rad, [4, 5])).all()
    assert (boards.force_n[1], boards.temperature_c[2]) == (1.5, 30)


def test_signs_turn_the_angles_round():
    signs = tuple(-1 if motor == 4 else 1 for motor in range(12))
    boards = Boards(DexHandConfig(signs=signs), 1, 1, 45.0, 1)
    boards.take(0, status(cdeg=(-3000, 2000)))
    assert np.degrees(boards.angle_rad[4:6]) == pytest.approx([30, 20])


def test_nan_forces_are_not_known_and_implausible_angles_are_not_believed(boards):
    boards.take(0, status())
    boards.take(1, status(force=None, cdeg=(30000, 2500)))
    assert np.isnan(boards.force_n[1])
    assert np.degrees(boards.angle_rad[4:6]) == pytest.approx([30, 25])
    assert boards.counts["implausible"] == 1


def test_ages_and_rates(boards):
    for moment in range(20):
        boards.take(moment * 20 * MS, status())
    now = 19 * 20 * MS + 5 * MS
    assert boards.age_ns(now)[2] == 5 * MS and boards.age_ns(now)[0] > 10**14
    assert boards.rate_hz(now)[2] == pytest.approx(50)
    assert boards.rate_hz(now)[0] == 0
    assert boards.rate_hz(now + 1000 * MS)[2] < 1


def test_the_other_hands_boards_are_passed_over(boards):
    assert boards.take(0, status(board=3)) is None
    assert boards.counts["other_hand"] == 1 and np.isnan(boards.angle_rad).all()


def test_a_reported_error_is_cleared_per_board_with_growing_pauses(boards):
    report = ErrorReport(9, (True, False), (MotorFlag.STALL, NONE), b"\xee\x01\x04")
    boards.take(0, report)
    assert boards.flags[4] == 4 and boards.sensed().flagged[4] and not boards.sensed().flagged[5]
    sent = []
    for moment in range(0, 2000, 10):
        due = boards.clears(moment * MS)
        sent += [moment for command in due if command == ClearError(9)]
        if due:
            boards.take(moment * MS, report)
    assert np.diff([0, *sent]).tolist() == [100, 200, 400, 400, 400, 400]
    assert boards.counts["clears"] == 6


def test_a_status_without_errors_ends_the_clearing_and_calm_resets_the_pause(boards):
    boards.take(0, status(errors=(NONE, MotorFlag.OVERLOAD)))
    assert boards.clears(0) == [] and boards.clears(100 * MS) == [ClearError(9)]
    boards.take(101 * MS, status())
    assert not boards.flags.any()
    assert [boards.clears(moment * MS) for moment in (300, 800)] == [[], []]
    boards.take(900 * MS, status(errors=(NONE, MotorFlag.OVERLOAD)))
    boards.clears(900 * MS)
    assert boards.clears(1000 * MS) == [ClearError(9)]  # the first pause again


def test_heat_lasts_until_a_cool_reading(boards):
    boards.take(0, OverTemperature(9))
    assert boards.overheated.tolist() == [False, False, True, False, False, False]
    boards.take(1, status(temperature=50))
    assert boards.overheated[2]
    boards.take(2, status(temperature=44))
    assert not boards.overheated.any()


def test_the_palm_without_a_thermometer_is_hot_for_a_while_and_as_long_as_the_hottest_board(boards):
    palm = [False, True, False, False, False, False]
    boards.take(0, status(temperature=30))
    boards.take(3, OverTemperature(8))
    boards.take(4, status(board=8))
    assert boards.overheated.tolist() == palm  # that it answers says nothing
    boards.take(5, status(temperature=46))
    boards.take(3 + 1000 * MS, status(board=8))
    assert boards.overheated.tolist() == palm
    boards.take(4 + 1000 * MS, status(temperature=45))
    boards.take(5 + 1000 * MS, status(board=8))
    assert not boards.overheated.any()


def test_the_palm_rests_even_if_the_others_are_cool_and_is_never_cool_while_nobody_knows(boards):
    boards.take(0, status(temperature=30))
    boards.take(3, OverTemperature(8))
    for moment_ns, hot in [(2 + 1000 * MS, True), (3 + 1000 * MS, False)]:
        boards.take(moment_ns, status(board=8))
        assert boards.overheated[1] == hot
    boards.take(0, OverTemperature(9))
    boards.take(0, OverTemperature(8))
    boards.take(5000 * MS, status(board=8))
    assert boards.overheated[1]


def test_other_replies_are_counted(boards):
    for reply in (WarningReport(9, 1, b""), Startup(9, b""), OverTemperature(9)):
        assert boards.take(0, reply) is None
    assert boards.counts == {"warnings": 1, "starts": 1, "overheats": 1}
    assert [boards.take_restarted().tolist() for _ in range(2)] == [
        [False] * 2 + [True] + [False] * 3,
        [False] * 6,
    ]
    deaf = Boards(DexHandConfig(startup_frame="ignored"), 100 * MS, 400 * MS, 45.0, 1000 * MS)
    deaf.take(0, Startup(9, b"\x01"))
    assert deaf.counts == {"ignored_starts": 1}  # and no `starts`, which end what runs

import numpy as np
import pytest

from common.dexhand021.angles import to_normalised
from common.dexhand021.commands import BoardMotion, BroadcastMotion, ShortMotion
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import HIGH_RAD, ControlMode
from common.hand_messages import Drive, HandCommand
from services.hand_io.limits import Sensed
from services.hand_io.limits_config import LimitsConfig
from services.hand_io.set_points import SetPoints

MS = 1_000_000
EMPTY = np.zeros(0, np.float32)
NOBODY = np.zeros(12, np.bool_)
HERE = HIGH_RAD / 2
HERE[3] = 0.05


class Bench:
    def __init__(self, **hand):
        self.points = SetPoints(LimitsConfig(), DexHandConfig(**hand), 500 * MS)
        self.now_ns, self.angle = 10**18, HERE.copy()

    @property
    def sensed(self):
        return Sensed(self.angle, np.full(6, 30.0), NOBODY)

    def order(self, drive, action=EMPTY, ms=300):
        command = HandCommand(drive, np.asarray(action, np.float32), ms * MS)
        self.points.command(self.now_ns, command, self.sensed)

    def go(self, ms=20, silent=NOBODY):
        self.now_ns += ms * MS
        return self.points.step(self.now_ns, self.sensed, silent)


def test_without_a_command_no_motor_has_torque():
    bench = Bench()
    safe = bench.go()
    assert not safe.enabled.any() and not safe.current.any()
    (command,) = bench.points.commands()
    assert command.mode is ControlMode.ZERO_TORQUE and not any(m.enabled for m in command.motors)


def test_hold_takes_each_motor_where_it_is():
    bench = Bench()
    bench.go()
    bench.order(Drive.HOLD)
    assert np.allclose(bench.go().position_rad, HERE) and bench.points.sent.enabled.all()


def test_hold_goes_by_the_newest_reading_not_by_what_was_last_sent():
    bench = Bench()
    bench.angle[:] = np.nan
    bench.go()
    bench.angle[:] = HERE  # the boards have just been heard for the first time
    bench.order(Drive.HOLD)
    for _ in range(20):
        assert np.allclose(bench.go().position_rad, HERE)


def test_follow_arrives_in_time_on_a_straight_way():
    bench = Bench()
    bench.go()
    target = HERE + 0.2 * (np.arange(12) > 3)
    bench.order(Drive.FOLLOW, to_normalised(target), ms=300)
    way = [bench.go().position_rad[5] - HERE[5] for _ in range(20)]
    assert way[6] == pytest.approx(0.2 * 140 / 300, abs=0.03)
    assert way[-1] == pytest.approx(0.2, abs=1e-5) and not bench.points.limited.any()


def test_a_target_too_far_away_is_limited_and_says_so():
    bench = Bench()
    bench.go()
    bench.order(Drive.FOLLOW, np.full(12, -1.0), ms=100)
    for _ in range(6):
        bench.go()
    assert bench.points.limited.any() and bench.points.counts["rate"] > 0


def test_hold_after_follow_stops_where_the_set_point_is_not_where_it_was_to_go():
    bench = Bench()
    bench.go()
    bench.order(Drive.FOLLOW, np.full(12, -1.0), ms=100)
    for _ in range(5):
        there = bench.go().position_rad
    bench.order(Drive.HOLD)
    assert all(np.allclose(bench.go().position_rad, there) for _ in range(5))


def test_silence_of_the_service_ends_in_no_torque_and_counts_survive():
    bench = Bench()
    bench.go()
    bench.order(Drive.FOLLOW, np.full(12, -1.0), ms=100)
    states = [bool(bench.go().enabled.any()) for _ in range(30)]
    assert states == [True] * 25 + [False] * 5
    assert bench.points.drive is Drive.OFF and bench.points.counts["rate"] > 0


@pytest.mark.parametrize("drive", [Drive.HOLD, Drive.FOLLOW])
def test_a_lost_board_is_released_and_starts_where_its_joints_have_gone_if_the_hand_follows(drive):
    lost, follows = np.arange(12) < 2, drive is Drive.FOLLOW
    bench = Bench()
    bench.go()
    bench.order(drive, to_normalised(HERE) if follows else EMPTY)
    assert bench.go().enabled.all()
    for _ in range(3):
        assert bench.go(silent=lost).enabled.tolist() == [False] * 2 + [True] * 10
    bench.angle[:2] -= 0.2
    safe = bench.go()
    assert safe.enabled.tolist() == [follows] * 2 + [True] * 10
    assert np.allclose(safe.position_rad, bench.angle + 1.5 * 0.02 * (lost & follows), atol=1e-6)
    bench.order(Drive.FOLLOW, to_normalised(HERE))
    assert bench.go().enabled.all()


def test_it_starts_again_from_where_the_joint_has_gone():
    bench = Bench()
    bench.go()
    bench.order(Drive.HOLD)
    bench.go()
    bench.order(Drive.OFF)
    bench.angle = HERE - 0.15 * (np.arange(12) != 3)
    bench.go()
    bench.order(Drive.HOLD)
    assert np.allclose(bench.go().position_rad, bench.angle)


@pytest.mark.parametrize(
    ("motion", "kinds"),
    [("broadcast", [BroadcastMotion]), ("board", [BoardMotion] * 6), ("board_short", [ShortMotion] * 6)],
)
def test_each_way_of_commanding_says_the_same(motion, kinds):
    bench = Bench(motion=motion, signs=(-1,) * 12)
    bench.go()
    bench.order(Drive.HOLD)
    bench.go()
    commands = bench.points.commands()
    assert [type(command) for command in commands] == kinds
    targets = [target for command in commands for target in command.motors]
    assert [t.position for t in targets] == [-round(100 * np.degrees(angle)) for angle in HERE]
    assert all(target.enabled for target in targets)

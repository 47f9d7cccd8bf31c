"""Somebody switches the hand off, moves its joints and switches it on again: it does not jump back."""

import time

import numpy as np
import pytest

from common.hand_messages import ArmWish
from services.sim.emulator_config import FaultKind
from tests.unit.services.hand_io.kinematic import KinematicTwin
from tests.unit.services.hand_io.rig import Rig

BRIEF_S, LONG_S = 0.45, 1.0  # between `stale_ms` and `silent_s`, and beyond both
AWAY_RAD = 0.25


class PushedTwin(KinematicTwin):
    """Remembers how far a motor with torque was from its set point, and its joints can be pushed."""

    def __init__(self):
        super().__init__()
        self.gap_rad = 0.0
        self.push_rad = np.zeros(12)

    def advance(self, seconds):
        push_rad, self.push_rad = self.push_rad, np.zeros(12)
        self.joint_angles_rad = self.joint_angles_rad + push_rad
        gap = np.abs(self.targets - self.joint_angles_rad)[self.powered]
        self.gap_rad = max(self.gap_rad, gap.max(initial=0.0))
        super().advance(seconds)


def cut(hand, for_s):
    """Take the power for so long, and push every joint but the spread meanwhile; where they are then."""
    hand.inject(FaultKind.POWER, for_s=for_s)
    hand.wait(lambda: not hand.twin.powered.any(), "limp motors")
    hand.twin.push_rad = AWAY_RAD * (np.arange(12) != 3)
    hand.wait(lambda: not hand.twin.push_rad.any(), "the push")
    hand.twin.gap_rad = 0.0
    there = hand.twin.joint_angles_rad.copy()
    hand.wait(lambda: hand.joint.board_age_ms.max() > 300, "silence")
    hand.wait(lambda: hand.joint.board_age_ms.max() < 100, "the boards")
    return there


@pytest.fixture
def started(request):
    hand = Rig(twin=PushedTwin(), hold_s=5.0, startup=request.param)
    hand.run()
    yield hand
    hand.close()


CASES = [("restart", BRIEF_S, False), ("restart", LONG_S, False), ("ignored", LONG_S, False)]
CASES += [("restart", BRIEF_S, True), ("ignored", BRIEF_S, True), ("ignored", LONG_S, True)]


@pytest.mark.parametrize(("started", "for_s", "disarmed"), CASES, indirect=["started"])
def test_a_hand_that_was_without_power_is_limp_and_stays_where_it_was_put(started, for_s, disarmed):
    if disarmed:
        assert started.arm(ArmWish.DISARM).accepted
        started.wait(lambda: started.state == "hold" and started.twin.powered.all(), "hold with torque")
    there = cut(started, for_s)
    started.wait(lambda: started.state == "hold", "hold")
    time.sleep(0.4)
    assert np.array_equal(started.twin.joint_angles_rad, there)
    assert started.twin.gap_rad == 0.0 and not started.twin.powered.any()


@pytest.mark.parametrize("started", ["ignored"], indirect=True)
def test_an_armed_hand_that_goes_on_after_a_brief_cut_starts_from_where_its_joints_are(started):
    cut(started, BRIEF_S)
    started.wait(lambda: bool(started.twin.powered.all()), "torque")
    started.next_steps(5)
    assert started.state == "running"
    assert started.twin.gap_rad < 0.15  # of 0.25: no more than the way of a few frames at the limit

"""Each fault of the emulated hand on a bus: what the hand does, what people are told, how it goes on."""

import random
import time
from itertools import pairwise

import numpy as np
import pytest

from bench.can import free_port
from common.can_link import CanLink
from common.dexhand021.frames import FD_LENGTHS, Frame
from common.hand_messages import ArmWish
from services.sim.emulator_config import FaultKind
from tests.unit.services.hand_io.rig import Rig


@pytest.fixture(scope="module")
def shared():
    rig = Rig("udp_multicast", free_port())
    rig.wait(lambda: rig.joint is not None and not rig.joint.faults, "the hand")
    yield rig
    rig.close()


@pytest.fixture
def rig(shared):
    shared.run()
    begin = len(shared.steps)
    yield shared
    assert shared.twin.within_limits  # on the joints themselves, not on the commands
    assert shared.emulator.hand.counts["beyond_range"] == 0
    assert_nothing_lost(shared.steps[begin:])


def all_powered(rig):
    return bool(rig.emulator.hand.powered.all())


def none_powered(rig):
    return not rig.emulator.hand.powered.any()


def assert_nothing_lost(samples):
    """Within each start of an episode, k counts up by one."""
    for before, after in pairwise(samples):
        same = (before.header.boot_id, before.message.episode) == (
            after.header.boot_id,
            after.message.episode,
        )
        assert after.message.k == before.message.k + 1 if same else after.message.k == 0
        assert np.isfinite(after.message.state).all()


def test_a_stalled_motor_is_released_its_error_cleared_and_the_episode_goes_on(rig):
    boot = rig.steps[-1].header.boot_id
    rig.inject(FaultKind.STALL, board="index", motor=1, for_s=0.4)
    rig.wait(lambda: rig.told("ff_dip: STALL"), "the stall to be told")
    rig.wait(lambda: not rig.emulator.hand.powered[4], "the release")
    rig.wait(lambda: rig.emulator.hand.powered.all() and not rig.joint.flags.any(), "the motor to work again")
    assert rig.state == "running" and rig.steps[-1].header.boot_id == boot
    rig.next_steps()


def test_over_temperature_is_a_fault_that_ends_in_hold_and_the_episode_begins_anew(rig):
    before = rig.steps[-1]
    rig.inject(FaultKind.OVERHEAT, board="ring", for_s=0.5)
    rig.wait(lambda: rig.state == "fault" and rig.told("too hot: ring"), "the fault")
    reply = rig.arm()
    assert not reply.accepted and "too hot" in reply.reason
    rig.wait(lambda: rig.state == "hold", "hold")
    assert not rig.emulator.hand.powered.any()
    steps = len(rig.steps)
    time.sleep(0.3)
    assert len(rig.steps) == steps and rig.state == "hold"  # it waits for a person
    assert rig.arm().accepted
    rig.next_steps()
    after = rig.steps[-1]
    assert after.message.episode == before.message.episode
    assert after.header.boot_id == before.header.boot_id + 1


def test_a_fingertip_that_says_nan_makes_forces_invalid_and_nothing_else(rig):
    rig.inject(FaultKind.NAN_TACTILE, board="thumb", for_s=0.4)
    rig.wait(lambda: rig.steps[-1].message.part_valid.tolist() == [1, 0, 1, 1], "invalid forces")
    rig.wait(lambda: rig.told("no force: thumb"), "the fingertip to be told")
    rig.wait(lambda: bool(rig.steps[-1].message.part_valid.all()), "valid forces")
    assert rig.state == "running"


def test_a_board_that_is_briefly_silent_makes_its_parts_invalid(rig):
    rig.inject(FaultKind.SILENT, board="middle", for_s=0.45)
    rig.wait(lambda: not rig.steps[-1].message.part_valid[0], "invalid angles")
    old = rig.steps[-1].message
    assert old.part_age_ms[0] > 250 > old.part_age_ms[2]
    rig.wait(lambda: bool(rig.steps[-1].message.part_valid.all()), "valid angles")
    assert rig.state == "running"


def test_a_board_that_stays_silent_puts_the_hand_on_hold(rig):
    rig.inject(FaultKind.SILENT, board="palm", for_s=1.2)
    rig.wait(lambda: rig.state == "hold" and rig.told("silent: palm"), "hold")
    here = rig.twin.joint_angles_rad.copy()
    assert not rig.arm().accepted
    time.sleep(0.2)
    assert np.allclose(rig.twin.joint_angles_rad, here, atol=0.02)
    rig.wait(lambda: not rig.joint.faults, "the board")
    assert rig.state == "hold"


@pytest.mark.parametrize(
    ("kind", "amount"),
    [(FaultKind.DUPLICATE, 0), (FaultKind.REORDER, 0), (FaultKind.DELAY, 30), (FaultKind.DRIFT, 0.2)],
)
def test_the_hand_goes_on_through(rig, kind, amount):
    rig.inject(kind, for_s=0.5, amount=amount)
    steps = rig.next_steps(10)
    doubts = [(step.part_valid.tolist(), step.part_age_ms.round().tolist()) for step in steps]
    assert all(step.part_valid.all() for step in steps), doubts
    assert rig.state == "running"


def test_a_warm_board_rests_below_the_hands_own_limit_while_the_others_work(rig):
    rig.inject(FaultKind.WARM, board="little", for_s=0.4, amount=52)
    rig.wait(lambda: not rig.emulator.hand.powered[10:].any(), "the pause")
    others = [*range(2), *range(4, 10)]  # the palm has no thermometer: it rests with the warmest
    assert rig.emulator.hand.powered[others].all() and rig.state == "running"
    rig.wait(lambda: all_powered(rig), "the end of the pause")


def test_bus_off_is_a_fault_the_bus_is_opened_again_and_the_hand_stays_in_hold(rig):
    rig.inject(FaultKind.BUS_OFF, for_s=0.5)
    rig.wait(lambda: rig.state == "fault" and rig.told("bus off"), "the fault")
    rig.wait(lambda: none_powered(rig), "limp motors")
    rig.wait(lambda: rig.state == "hold" and not rig.joint.faults, "hold")
    time.sleep(0.2)
    assert rig.state == "hold" and not rig.emulator.hand.powered.any()


def test_who_disarms_a_hand_keeps_it_disarmed_and_it_lets_go_after_a_while(rig):
    assert rig.arm(ArmWish.DISARM).accepted
    rig.wait(lambda: rig.state == "hold", "hold")
    rig.wait(lambda: none_powered(rig), "no torque")
    assert rig.arm(ArmWish.STATUS).state == "hold"


def test_fuzzed_frames_neither_end_nor_move_anything():
    rig = Rig()
    rig.wait(lambda: rig.joint is not None and not rig.joint.faults, "the hand")
    link, rng = CanLink(rig.can), random.Random(7)
    for number in range(4000):
        frame = Frame(rng.choice((rng.randrange(0x800), 0x187 + rng.randrange(6))), b"")
        link.send(Frame(frame.can_id, rng.randbytes(rng.choice(FD_LENGTHS))))
        if number % 50 == 0:
            time.sleep(0.001)
    link.close()
    health = len(rig.health)
    rig.wait(lambda: len(rig.health) >= health + 2, "heartbeats of both")
    assert rig.twin.moved_rad == 0.0 and not rig.emulator.hand.powered.any()
    assert rig.state in ("hold", "fault") and not rig.steps
    rig.close()

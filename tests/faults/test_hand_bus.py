"""Each fault of an emulated hand in another process: what the hand does, what people see, how it goes on."""

import time
from itertools import pairwise

import numpy as np
import pytest

from common.hand_messages import ArmWish
from common.topics import HAND_JOINTS, STEP
from services.sim.emulator_config import FaultKind
from tests.faults.cell import wait
from tests.faults.hand_cell import HandCell

pytestmark = [pytest.mark.processes, pytest.mark.timeout(120)]

SOFT_RAD = 0.01  # MuJoCo's end stops give way by so much
INDEX_DISTAL, LITTLE = 4, slice(10, 12)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    cell = HandCell(tmp_path_factory.mktemp("hand"))
    try:
        cell.ready()
        yield cell
    finally:
        cell.end()


@pytest.fixture
def hand(shared):
    """The hand, executing random actions; whatever the test did to it, no joint left its range for it."""
    shared.run()
    begun, at = len(shared.steps), time.monotonic()
    yield shared
    beyond_rad = shared.physics.beyond_rad(shared.physics.since(at))
    assert beyond_rad < SOFT_RAD
    assert_nothing_lost(shared.steps[begun:])


def assert_nothing_lost(samples):
    """Within each start of an episode, k counts up by one."""
    for before, after in pairwise(samples):
        same = (before.header.boot_id, before.message.episode) == (
            after.header.boot_id,
            after.message.episode,
        )
        assert after.message.k == before.message.k + 1 if same else after.message.k == 0
        assert np.isfinite(after.message.state).all()


def torque(hand, at):
    """Which motors had torque in each round since then: (n, 12)."""
    return hand.physics.since(at)[:, -12:] > 0


def released(hand, at):
    """Whether the stalled motor has lost its torque since then, and has it again."""
    powered = torque(hand, at)[:, INDEX_DISTAL]
    return not powered.all() and powered[-1]


def boot(hand):
    return hand.steps[-1].header.boot_id


def test_a_stalled_motor_is_released_its_error_cleared_and_the_episode_goes_on(hand):
    before, at = boot(hand), time.monotonic()
    hand.inject(FaultKind.STALL, board="index", motor=1, for_s=0.4)
    wait(lambda: hand.told("ff_dip: STALL", at), "the stall to be told")
    wait(lambda: released(hand, at), "release and return")
    wait(lambda: not hand.joints.flags.any(), "the clearing")
    powered = torque(hand, at)
    assert np.flatnonzero(~powered.all(axis=0)).tolist() == [INDEX_DISTAL]  # the others never stopped
    assert hand.state == "running" and boot(hand) == before
    assert hand.count("error_frames") >= 1 and hand.count("clears") >= 1
    hand.next_steps()


def test_over_temperature_is_a_fault_that_ends_in_hold_and_the_episode_begins_anew(hand):
    before, at = hand.steps[-1], time.monotonic()
    hand.inject(FaultKind.OVERHEAT, board="ring", for_s=0.6)
    wait(lambda: hand.told("too hot: ring", at, "fault"), "the fault")
    reply = hand.ask()
    assert not reply.accepted and "too hot" in reply.reason
    wait(lambda: hand.reported("fault: too hot: ring", at), "the report")
    wait(lambda: hand.state == "hold", "hold")
    assert not hand.physics.powered.any()
    at, steps = time.monotonic(), len(hand.steps)
    time.sleep(0.3)
    assert len(hand.steps) == steps and hand.state == "hold"  # it waits for a person
    assert not torque(hand, at).any()
    assert hand.ask().accepted
    hand.next_steps()
    after = hand.steps[-1]
    assert after.message.episode == before.message.episode
    assert after.header.boot_id == before.header.boot_id + 1


def test_a_fingertip_that_says_nan_makes_forces_invalid_and_nothing_else(hand):
    at = time.monotonic()
    hand.inject(FaultKind.NAN_TACTILE, board="thumb", for_s=0.4)
    wait(lambda: [1, 0, 1, 1] in validity(hand, at), "invalid forces")
    wait(lambda: hand.told("no force: thumb", at), "the fingertip to be told")
    wait(lambda: bool(hand.steps[-1].message.part_valid.all()), "valid forces")
    assert hand.state == "running" and torque(hand, at).all()
    assert all(parts in ([1, 0, 1, 1], [1, 1, 1, 1]) for parts in validity(hand, at))


def validity(hand, at):
    """Of the parts in each step since then."""
    return [sample.message.part_valid.tolist() for sample in hand.ear.samples(STEP, at)]


def test_a_board_that_is_briefly_silent_makes_its_parts_invalid(hand):
    at = time.monotonic()
    hand.inject(FaultKind.SILENT, board="middle", for_s=0.5)
    wait(lambda: [0, 0, 1, 1] in validity(hand, at), "invalid angles and forces")
    wait(lambda: bool(hand.steps[-1].message.part_valid.all()), "valid angles")
    old = [s.message for s in hand.ear.samples(STEP, at) if not s.message.part_valid[0]]
    assert all(step.part_age_ms[0] > 250 > step.part_age_ms[2] for step in old)
    assert np.flatnonzero(~torque(hand, at).all(axis=0)).tolist() == [6, 7]  # a deaf board lets go by itself
    assert hand.state == "running"
    assert hand.count("late_cycles") >= 10  # one for each cycle without its answer


def test_a_board_that_stays_silent_puts_the_hand_on_hold_without_torque(hand):
    begun = time.monotonic()
    hand.inject(FaultKind.SILENT, board="palm", for_s=2.2)
    wait(lambda: hand.told("silent: palm", begun, "hold"), "hold")
    reply = hand.ask()
    assert not reply.accepted and "silent: palm" in reply.reason
    assert_limp_once_it_is_back(hand)


@pytest.mark.parametrize("for_s", [0.5, 2.0])
def test_a_hand_that_was_without_power_stays_limp_until_a_person_arms_it(hand, for_s):
    hand.inject(FaultKind.POWER, for_s=for_s)
    wait(lambda: hand.state == "hold", "hold")
    assert_limp_once_it_is_back(hand)
    assert hand.count("starts") >= 6


def assert_limp_once_it_is_back(hand):
    wait(lambda: not hand.physics.powered.any(), "no torque")
    at = time.monotonic()
    wait(lambda: not hand.joints.faults, "the boards")
    time.sleep(0.3)
    assert hand.state == "hold" and not torque(hand, at).any()


DISTURBANCES = [
    (FaultKind.DUPLICATE, 0.0, "repeated_answers"),
    (FaultKind.REORDER, 0.0, "repeated_answers"),
    (FaultKind.DELAY, 30.0, "late_cycles"),
]


@pytest.mark.parametrize(("kind", "amount", "counted"), DISTURBANCES)
def test_the_hand_goes_on_through_a_disturbed_bus_and_counts_it(hand, kind, amount, counted):
    before, at = hand.count(counted), time.monotonic()
    hand.inject(kind, for_s=0.5, amount=amount)
    steps = hand.next_steps(10)
    doubts = [(step.part_valid.tolist(), step.part_age_ms.round().tolist()) for step in steps]
    assert all(step.part_valid.all() for step in steps), doubts
    assert hand.state == "running" and torque(hand, at).all()
    assert hand.count(counted) > before


def test_a_sensor_that_drifts_leads_no_joint_out_of_its_range(hand):
    refused = hand.count("implausible")
    hand.inject(FaultKind.DRIFT, board="index", for_s=1.0, amount=1.2)
    wait(lambda: hand.count("implausible") > refused, "readings that no joint can have")
    at = time.monotonic()
    hand.inject(FaultKind.STALL, board="index", motor=1, for_s=0.4)  # it starts again from a wrong reading
    wait(lambda: released(hand, at), "release and return")
    hand.next_steps(10)
    assert hand.state == "running"
    hand.inject(FaultKind.DRIFT, board="index", for_s=1.0, amount=-1.2)
    wait(lambda: sees_truth(hand), "readings as they should be")


def sees_truth(hand):
    """Whether the newest readings are those of a moment within the last half second."""
    recent = hand.physics.angles(hand.physics.since(time.monotonic() - 0.5))
    return np.abs(recent - hand.joints.q_rad).max(axis=1).min() < 0.02


def test_a_warm_board_rests_below_the_hands_own_limit_while_the_others_work(hand):
    at = time.monotonic()
    hand.inject(FaultKind.WARM, board="little", for_s=0.4, amount=52)
    wait(lambda: any(s.message.temperature_c[5] == 52 for s in hand.ear.samples(HAND_JOINTS, at)), "the news")
    wait(lambda: hand.physics.powered.all() and not torque(hand, at)[:, LITTLE].all(), "pause and its end")
    others = [*range(2), *range(4, 10)]  # the palm has no thermometer: it rests with the warmest
    assert torque(hand, at)[:, others].all() and hand.state == "running"
    assert hand.count("limit_temperature") >= 2


def test_bus_off_is_a_fault_the_bus_is_opened_again_and_the_hand_stays_in_hold(hand):
    opened, at = hand.count("opens"), time.monotonic()
    hand.inject(FaultKind.BUS_OFF, for_s=0.7)
    wait(lambda: hand.told("bus off", at, "fault"), "the fault")
    wait(lambda: hand.reported("fault: bus off", at), "the report")
    wait(lambda: not hand.physics.powered.any(), "limp motors")
    wait(lambda: hand.state == "hold" and not hand.joints.faults, "hold")
    at = time.monotonic()
    time.sleep(0.2)
    assert hand.state == "hold" and not torque(hand, at).any()
    assert hand.count("opens") > opened


def test_who_disarms_a_hand_keeps_it_disarmed_and_it_lets_go_after_a_while(hand):
    assert hand.ask(ArmWish.DISARM).accepted
    wait(lambda: hand.state == "hold", "hold")
    wait(lambda: not hand.physics.powered.any(), "no torque")
    assert hand.ask(ArmWish.STATUS).state == "hold"

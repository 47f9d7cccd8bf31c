import pytest

from common.hand_messages import ArmWish
from services.hand_io.arming import Arming, Condition, State

WELL, TROUBLE, FAULT = Condition(), Condition(troubles=("silent: palm",)), Condition(faults=("bus off",))
MS = 1_000_000


class Watched:
    """An arming with a clock; every call lets 10 ms pass."""

    def __init__(self, auto=False):
        self.arming, self.now_ns = Arming(auto, 100 * MS), 0

    def be(self, condition=WELL, times=1, busy=False, relaxed=False):
        for _ in range(times):
            self.now_ns += 10 * MS
            self.arming.update(self.now_ns, condition, busy, relaxed)
        return self.arming.state

    def armed(self):
        self.be()
        assert self.arming.wish(ArmWish.ARM).accepted
        return self


def test_it_starts_in_hold_and_stays_there_until_a_person_arms_it():
    watched = Watched()
    assert not watched.arming.wish(ArmWish.ARM).accepted  # before anything was heard
    assert watched.be(times=100, busy=True) is State.HOLD
    assert watched.armed().arming.state is State.ARMED


def test_it_follows_the_episode_and_the_silence():
    watched = Watched().armed()
    assert [watched.be(), watched.be(busy=True)] == [State.ARMED, State.RUNNING]
    assert [watched.be(busy=True, relaxed=True), watched.be(busy=True)] == [State.RELAX, State.RUNNING]
    assert watched.be() is State.ARMED


@pytest.mark.parametrize("busy", [False, True])
@pytest.mark.parametrize("relaxed", [False, True])
@pytest.mark.parametrize(("condition", "then"), [(TROUBLE, State.HOLD), (FAULT, State.FAULT)])
def test_trouble_and_faults_disarm_from_every_state(busy, relaxed, condition, then):
    watched = Watched().armed()
    watched.be(busy=busy, relaxed=relaxed)
    assert watched.be(condition, busy=busy) is then
    assert not watched.arming.wish(ArmWish.ARM).accepted
    assert watched.be(times=200, busy=busy) is State.HOLD  # and never further by itself


def test_a_fault_is_over_only_after_a_while_without_anything_wrong():
    watched = Watched().armed()
    watched.be(FAULT)
    assert watched.be(times=10) is State.FAULT
    watched.be(TROUBLE)
    assert watched.be(times=10) is State.FAULT
    refused = watched.arming.wish(ArmWish.ARM)
    assert (refused.accepted, refused.state, refused.reason) == (
        False,
        "fault",
        "the fault has only just passed",
    )
    assert watched.be() is State.HOLD
    assert watched.arming.faults_seen == 1


def test_auto_arms_after_a_calm_while_but_not_what_a_person_has_disarmed():
    watched = Watched(auto=True)
    assert watched.be(times=10) is State.HOLD
    assert watched.be() is State.ARMED
    watched.be(FAULT)
    assert watched.be(times=12) is State.ARMED
    assert watched.arming.wish(ArmWish.DISARM).accepted
    assert watched.be(times=200) is State.HOLD


def test_asking_changes_nothing_and_disarming_ends_no_fault():
    watched = Watched().armed()
    assert watched.arming.wish(ArmWish.STATUS).state == "armed"
    assert watched.arming.wish(ArmWish.ARM).accepted
    watched.be(FAULT)
    assert watched.arming.wish(ArmWish.DISARM).state == "fault"
    told = watched.arming.wish(ArmWish.STATUS)
    assert told.accepted and told.reason == "; ".join(FAULT.wrong) != ""

"""Only poses of the die that are claimed are used; the others are counted, and change nothing."""

from dataclasses import replace

import numpy as np
import pytest

from common.cell import ControlConfig
from common.hand_messages import PoseSource
from common.messages import Episode, Mode, Warmup
from common.topics import EPISODE, OBJECT_POSE
from tests.unit.services.hand_io.hand import FRAME_NS, POSE, DrivenService

FAR = np.array([0.09, 0.02, 0.18], np.float32)


@pytest.fixture
def hand():
    """An armed hand within an episode of random actions, that has seen one claimed pose."""
    driven = DrivenService(ControlConfig(rate_hz=10, steps_per_plan=1), pose_stale_ms=200.0).armed()
    goal = np.zeros(0, np.float32)
    driven.send(EPISODE, Episode(1, 0, goal, Mode.RANDOM, Warmup.UNIFORM, 1000, 5))
    while not driven.steps:
        driven.turn(1)
    driven.pose = None  # from here on, poses are sent by hand
    return driven


def told(hand, message, **header):
    hand.send(OBJECT_POSE, message, **header)
    (step,) = hand.turn(1)
    return step


def refused(hand):
    fields = hand.service.report().fields
    return {name: fields[name] for name in fields if name.startswith("refused_poses")}


def test_a_claimed_pose_is_used(hand):
    step = told(hand, replace(POSE, position=FAR))
    assert step.state[17:20] == pytest.approx(FAR) and step.part_valid.all()
    assert refused(hand) == {}


@pytest.mark.parametrize(
    "message, valid, reason",
    [
        (replace(POSE, position=FAR), False, "unclaimed"),
        (replace(POSE, position=FAR, quality=0.3), True, "quality"),
        (replace(POSE, position=FAR, rotation=np.zeros(4, np.float32)), True, "quality"),
        (replace(POSE, position=FAR, source=PoseSource.PERCEPTION), True, "source"),
    ],
)
def test_an_unclaimed_pose_is_counted_and_the_last_claimed_one_stays_in_use(hand, message, valid, reason):
    step = told(hand, message, valid=valid)
    assert step.state[17:20] == pytest.approx(POSE.position)
    assert step.part_valid.all() and step.part_age_ms[2] == FRAME_NS / 1e6
    assert refused(hand) == {f"refused_poses_{reason}": 1.0}


def test_of_two_poses_between_two_steps_the_claimed_one_is_used_whichever_came_first(hand):
    hand.send(OBJECT_POSE, replace(POSE, position=FAR))
    step = told(hand, POSE, valid=False)
    assert step.state[17:20] == pytest.approx(FAR)


def test_without_claimed_poses_the_part_is_marked_once_the_last_one_is_stale(hand):
    """Ten steps of 20 ms: 200 ms after the last claimed pose the state says that nobody knows."""
    steps = [told(hand, replace(POSE, position=FAR), valid=False) for _ in range(12)]
    flags = [step.part_valid[2:].tolist() for step in steps]
    assert flags[0] == [1, 1] and flags[-1] == [0, 0]
    assert sum(flag == [1, 1] for flag in flags) == 10
    assert steps[-1].state[17:20] == pytest.approx(POSE.position)
    assert told(hand, replace(POSE, position=FAR)).part_valid.all()


@pytest.mark.parametrize(("ahead_ms", "reason"), [(200, None), (201, "future"), (0, None), (-1, "late")])
def test_a_pose_from_the_future_or_older_than_the_accepted_one_is_refused(hand, ahead_ms, reason):
    """The accepted one was seen at `now_ns`; the step that finds the next one comes 20 ms later."""
    seen_ns = hand.now_ns + (FRAME_NS + ahead_ms * 10**6 if ahead_ms > 0 else ahead_ms * 10**6)
    step = told(hand, replace(POSE, position=FAR), t_ns=seen_ns)
    assert refused(hand) == ({f"refused_poses_{reason}": 1.0} if reason else {})
    assert step.state[17:20] == pytest.approx(POSE.position if reason else FAR)

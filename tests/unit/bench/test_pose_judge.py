"""A backend's answers are judged as they should be: errors, late registration, claims while hidden."""

import numpy as np
import pytest

from bench.perception import judge as judging
from bench.perception import summary
from bench.perception.board import EVERY, HIDDEN_FRAMES, SLIDE_FRAMES, Board
from bench.perception.judge import Answers, follow, judge, reacquired_after
from bench.perception.library import Sequence
from bench.perception.sequence import Spec
from services.perception.backend import PoseEstimate, PoseState, Quality, Unseen
from services.perception.frames import Frame
from services.sim.camera import Optics
from tests.unit.services.perception.driven import DrivenPerception

K = Optics().camera_matrix
QUALITY = Quality(1.0, 0.0, 0.0, 1.0)


def true_pose(number):
    pose = np.eye(4)
    pose[:3, 3] = 0.001 * number, 0.0, 0.42
    return pose


def frame(number):
    picture = np.zeros((4, 6), np.uint16)
    return Frame(np.zeros((4, 6, 3), np.uint8), picture, 1e-3, K, number + 1, number + 1, number)


def estimate(number, shift_m=0.0, claimed=True):
    pose = true_pose(number)
    pose[0, 3] += shift_m
    state = PoseState.TRACKING
    return PoseEstimate(state, claimed, pose, np.eye(6), np.eye(24)[0], QUALITY, number + 1, number)


def sequence(occlusion):
    poses = np.array([true_pose(number) for number in range(len(occlusion))])
    return Sequence(Spec("made", 0, len(occlusion)), poses, np.array(occlusion, float), None)


class Scripted:
    """Knows the truth once it has been given a registration, from the frame after."""

    def __init__(self):
        self.found, self.registered = None, []

    def register(self, frame, mask=None):
        self.registered.append(frame.frame_number)
        return estimate(frame.frame_number)

    def adopt(self, found):
        self.found = found

    def track(self, frame):
        if self.found is None:
            return Unseen(PoseState.SEARCHING, "", frame.t_ns, frame.frame_number)
        return estimate(frame.frame_number)

    def reset(self):
        self.found = None


@pytest.mark.parametrize(("seconds", "late"), [(0.0, 1), (0.10, 6), (0.101, 7)])
def test_a_registration_is_used_as_late_as_it_took(monkeypatch, seconds, late):
    backend, clock = Scripted(), [0.0]
    monkeypatch.setattr(judging.time, "thread_time", lambda: clock[0])
    register = backend.register

    def slow(frame):
        clock[0] += seconds
        return register(frame)

    backend.register = slow
    answers = follow(backend, map(frame, range(12)), 60.0)
    assert backend.registered == [0]
    assert answers.started == [number >= late for number in range(12)]
    assert [bool(np.isfinite(pose).all()) for pose in answers.poses] == answers.started


def answered(sequence, answers):
    made = Answers()
    for answer in answers:
        made.take(answer, started=True)
    return judge(sequence, made)


def test_within_gross_and_claimed():
    seen = [
        estimate(0),
        estimate(1, 0.0029),
        estimate(2, 0.0031),
        estimate(3, 0.011),
        estimate(4, 0.5, False),
    ]
    judged = answered(sequence([0.1] * 6), [*seen, Unseen(PoseState.LOST, "", 6, 5)])
    assert judged.within.tolist() == [True, True, False, False, False, False]
    assert judged.gross.tolist() == [False, False, False, True, True, False]
    assert summary.gross_claimed([judged]) == {"share": 0.25, "gross": 1, "claimed": 4}
    figures = summary.figures([judged])
    assert figures["within_5deg_3mm"] == pytest.approx(2 / 6)
    assert (figures["frames"], figures["label_accuracy"]) == (6, 1.0)
    assert figures["add_mm"]["median"] == pytest.approx(3.1)


def test_bands_take_each_frame_once():
    judged = answered(sequence([0.0, 0.19, 0.2, 0.39, 0.4, 0.6, 0.99]), [estimate(n) for n in range(7)])
    assert [row["frames"] for row in summary.bands([judged])] == [2, 2, 1]


def test_reacquisition_counts_from_the_first_frame_that_is_not_hidden():
    hidden = [0, 0, 1, 1, 0, 0, 0, 1, 0, 0]
    answers = [estimate(n) for n in range(10)]
    answers[3] = estimate(3, 0.0, claimed=False)
    answers[4] = Unseen(PoseState.LOST, "", 5, 4)
    answers[5] = estimate(5, 0.004)  # claimed, but wrong
    answers[8] = answers[9] = Unseen(PoseState.LOST, "", 10, 9)
    judged = answered(sequence(hidden), answers)
    assert reacquired_after(judged, room=2) == [2, None]
    assert reacquired_after(judged, room=3) == [2]  # from the second return on two frames are left


@pytest.mark.parametrize(("late", "share"), [(30, 1.0), (31, 0.0)])
def test_a_share_of_the_trials_is_reacquired_in_time(late, share):
    hidden = [0, 1, 1] + 40 * [0] + [1] + 29 * [0]  # the last return leaves too little room for a trial
    found = [n < 3 or n >= 3 + late for n in range(len(hidden))]
    answers = [estimate(n) if seen else Unseen(PoseState.LOST, "", n + 1, n) for n, seen in enumerate(found)]
    summed = summary.reacquired([answered(sequence(hidden), answers)])
    assert (summed["trials"], summed["share"], summed["claimed_while_hidden"]) == (1, share, 3)


def test_frames_that_needed_other_starts_are_timed_apart():
    judged = answered(
        sequence([0.1] * 5), [estimate(n) for n in range(4)] + [Unseen(PoseState.LOST, "", 5, 4)]
    )
    judged.answers.attempts[3] = 4
    judged.answers.frame_ms, judged.answers.frame_cpu_ms = [4.0, 5.0, 6.0, 20.0, 99.0], [1.0] * 5
    times = summary.times([judged])
    assert (times["retried"], times["frame_ms_median"]) == (0.25, 5.5)
    assert times["frame_ms_p95"] == pytest.approx(6 + 0.85 * 14)
    assert times["frame_ms_p95_without_retries"] == pytest.approx(5.9)
    assert times["frame_ms_p95_of_retried"] == 20.0


def test_the_board_hides_the_die_for_as_long_as_it_says():
    centres = np.tile([0.0, 0.0, 0.42], (2 * EVERY + 40, 1))
    covers = Board(0.42, phase=40).covers(centres, K)
    first = 40 + SLIDE_FRAMES
    for begin in (first, first + EVERY):
        assert (covers[begin : begin + HIDDEN_FRAMES] == 1).all()
        assert covers[begin - SLIDE_FRAMES - 1] == covers[begin + HIDDEN_FRAMES + SLIDE_FRAMES] == 0
    assert not covers[:40].any()


class Elusive(Scripted):
    """Finds nothing in its first three searches; what it finds is lost again after three frames."""

    def __init__(self):
        super().__init__()
        self.left = 0

    def register(self, frame, mask=None):
        found = super().register(frame, mask)
        return found if len(self.registered) > 3 else super().track(frame)

    def adopt(self, found):
        super().adopt(found)
        self.left = 3

    def track(self, frame):
        self.left -= 1
        self.found = self.found if self.left >= 0 else None
        return super().track(frame)


def test_searches_begin_in_the_same_frames_as_the_services():
    """Each of them answered before the next frame, as those of the bench at 1 frame a second."""
    judged, served = Elusive(), Elusive()
    follow(judged, map(frame, range(20)), rate_hz=1.0)
    driven = DrivenPerception(served)
    for _ in range(20):
        driven.see()
    assert [number - 1 for number in served.registered] == judged.registered
    assert judged.registered[:5] == [0, 1, 2, 3, 7]

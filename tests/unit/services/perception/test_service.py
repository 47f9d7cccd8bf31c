"""The perception service: poses in the palm's frame, states, silences, resets, and workers that fail."""

import numpy as np
import pytest

from common import geometry
from common.bus import JobResult
from common.camera_messages import PoseState
from services.perception import rigid
from services.perception.backend import PoseEstimate, Quality, Unseen
from tests.unit.services.perception.driven import FRAME_NS, HELD, LATENCY_NS, T_PALM_CAMERA, DrivenPerception


def in_palm(pose):
    return rigid.split(T_PALM_CAMERA @ pose)


def turned(pose, degrees):
    turn = geometry.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.asarray(np.radians(degrees)))
    return pose @ rigid.join((0, 0, 0), turn)


class ScriptedBackend:
    """Says what it is told to; counts what it is asked."""

    def __init__(self, pose=HELD, **changes):
        self.pose, self.changes = pose, changes
        self.calls, self.adopted = [], False

    def answer(self, frame):
        if isinstance(self.pose, Exception):
            raise self.pose
        if self.pose is None or not self.adopted:
            state = PoseState.LOST if self.adopted else PoseState.SEARCHING
            return Unseen(state, "nowhere", frame.t_ns, frame.frame_number)
        return estimate(self.pose, frame, **self.changes)

    def register(self, frame, mask=None):
        self.calls.append("register")
        if self.pose is None:
            return Unseen(PoseState.SEARCHING, "nowhere to be found", frame.t_ns, frame.frame_number)
        return estimate(self.pose, frame)

    def adopt(self, found):
        self.calls.append("adopt")
        self.adopted = True

    def track(self, frame):
        return self.answer(frame)

    def reset(self):
        self.calls.append("reset")
        self.adopted = False


def estimate(pose, frame, *, claimed=True, state=PoseState.TRACKING, occluded=0.0):
    posterior = np.eye(24)[0]
    quality = Quality(0.9 * (1 - occluded), occluded, 0.01, 0.8)
    covariance = np.diag([1e-7] * 3 + [1e-5] * 3)
    return PoseEstimate(state, claimed, pose, covariance, posterior, quality, frame.t_ns, frame.frame_number)


def test_the_cube_is_found_followed_and_told_in_the_palms_frame_with_its_capture_time():
    driven = DrivenPerception().tracked()
    moved = rigid.join((0.002, 0.001, 0.0), (1, 0, 0, 0)) @ HELD
    driven.see(moved)
    sample = driven.poses[-1]
    position, rotation = in_palm(moved)
    assert np.linalg.norm(sample.message.position - position) < 0.0015
    assert geometry.angle(sample.message.rotation.astype(float), rotation) < 0.03
    assert sample.header.valid and sample.header.t_ns == driven.now_ns - LATENCY_NS
    assert sample.message.source == "perception" and sample.message.quality > 0.9
    assert driven.said.latency_ms == pytest.approx(LATENCY_NS / 1e6)
    assert driven.words == "tracking"


def test_one_picture_gives_one_pose_and_none_is_told_twice():
    driven = DrivenPerception().tracked()
    for _ in range(5):
        driven.see()
    driven.wait(0.2)
    times = [sample.header.t_ns for sample in driven.poses]
    assert len(times) == 5 and np.diff(times).tolist() == [FRAME_NS] * 4


def test_a_hidden_cube_is_lost_at_once_no_pose_is_told_and_it_is_found_again():
    driven = DrivenPerception().tracked()
    for _ in range(5):
        assert driven.see(None).state == "lost"
    assert "no marker" in driven.said.message or "nothing within reach" in driven.said.message
    assert not driven.poses
    states = [driven.see().state for _ in range(3)]
    assert states[-1] == "tracking" and driven.poses[-1].header.valid


def test_unplugged_suspect_then_lost_then_found_again_when_it_returns():
    driven = DrivenPerception().tracked()
    assert driven.wait(0.2).state == "tracking"
    assert driven.wait(0.2).state == "suspect"
    assert driven.said.message.startswith("no picture for 0.")
    driven.wait(0.8)
    assert driven.said.state == "lost"
    assert driven.said.message.endswith("is the camera unplugged?")
    assert not driven.poses  # nothing was told meanwhile
    states = [driven.see().state for _ in range(4)]
    assert states[-1] == "tracking" and driven.poses[-1].header.valid
    assert states[0] != "tracking"  # not believed before it was found anew


def test_before_the_first_picture_it_says_so_twice_a_second():
    driven = DrivenPerception()
    driven.wait(2.0)
    assert {s.message.state for s in driven.tracking} == {"searching"}
    assert 4 <= len(driven.tracking) <= 5
    assert driven.said.message == "no picture yet: is the camera plugged in, and its process running?"


def test_an_unclaimed_pose_is_told_as_invalid_and_does_not_move_the_filter():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    backend.changes = {"claimed": False, "state": PoseState.SUSPECT}
    backend.pose = turned(HELD, 20)
    driven.see()
    assert driven.said.state == "suspect" and not driven.said.claimed
    assert [sample.header.valid for sample in driven.poses] == [False]
    backend.changes, backend.pose = {}, HELD
    driven.see()
    assert driven.poses[-1].header.valid
    assert geometry.angle(driven.poses[-1].message.rotation.astype(float), in_palm(HELD)[1]) < 1e-3
    assert (driven.fields["claimed"], driven.fields["unclaimed"]) == (4, 1)


def test_quality_is_that_of_what_is_not_hidden():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    backend.changes = {"occluded": 0.5}
    driven.see()
    assert driven.poses[-1].message.quality == pytest.approx(0.9)
    assert driven.said.quality == pytest.approx([0.45, 0.5, 0.01, 0.8])


def test_a_person_may_ask_for_a_new_search():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    backend.calls.clear()
    reply = driven.reset()
    assert reply.accepted and reply.state == "searching"
    assert backend.calls == ["reset"] and driven.fields["resets"] == 1
    driven.see()
    driven.see()
    assert backend.calls == ["reset", "register", "adopt"]


def test_an_answer_to_an_earlier_search_is_not_taken():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    driven.jobs.clear()
    driven.now_ns += FRAME_NS
    driven.work, real_work = (lambda: None), driven.work
    driven.see(None)  # the backend is at work on it
    assert [job.name for job in driven.jobs] == ["track 0"]
    driven.reset()
    driven.work = real_work
    driven.work()
    assert not driven.poses and driven.said.state == "searching"


@pytest.mark.parametrize("reset", [True, False])
def test_a_search_that_fails_late_throws_nothing_away(reset):
    """Begun, and then out of date: by a reset and a new search, or as the backend saw the die by itself."""
    backend = ScriptedBackend(pose=None)
    driven = DrivenPerception(backend)
    driven.work, real_work = (lambda: None), driven.work
    driven.see()
    driven.do(driven.jobs.pop(0))
    late = driven.jobs.pop(0)
    assert late.name == "register 0"
    driven.work = real_work
    backend.pose, backend.adopted = HELD, True
    if reset:
        driven.reset()
        backend.adopted = True
    for _ in range(3):
        driven.see()
    assert driven.said.state == "tracking"
    backend.calls.clear()
    driven.inbox.finish(JobResult(late.name, None, "RuntimeError: out of memory", 5_000_000))
    driven.turn()
    driven.work()
    assert driven.see().state == "tracking" and driven.poses[-1].header.valid
    assert "reset" not in backend.calls and driven.fields["failed_jobs"] == 1


def test_pictures_that_come_while_the_backend_works_wait_one_at_a_time():
    driven = DrivenPerception(ScriptedBackend()).tracked()
    driven.work, real_work = (lambda: None), driven.work
    driven.see(), driven.see(), driven.see()
    assert [job.name for job in driven.jobs] == ["track 0"]
    driven.work = real_work
    driven.work()
    assert [sample.header.t_ns for sample in driven.poses][-1] == driven.now_ns - LATENCY_NS
    assert len(driven.poses) == 2  # the first and the newest


def test_a_backend_that_fails_is_told_reset_and_tried_again():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    backend.pose = RuntimeError("out of memory")
    driven.see()
    assert driven.said.state == "lost" and "track failed: RuntimeError: out of memory" in driven.words
    assert not driven.poses and driven.fields["failed_jobs"] >= 1
    backend.pose = HELD
    driven.wait(0.2)
    states = [driven.see().state for _ in range(3)]
    assert states[-1] == "tracking"


def test_searches_pause_between_each_other():
    backend = ScriptedBackend(pose=None)
    driven = DrivenPerception(backend, search_pause_s=0.2)
    for _ in range(30):
        driven.see()
    assert 4 <= backend.calls.count("register") <= 6


def test_skipped_pictures_are_counted():
    driven = DrivenPerception().tracked()
    driven.number += 3
    driven.see()
    assert driven.fields["skipped"] == 3

"""States of the CPU backend over short films of exact pictures."""

from dataclasses import replace

import numpy as np
import pytest

from common.camera_messages import PoseState
from common.die import DIE
from services.perception.backend import PoseEstimate, Unseen
from services.perception.cpu.backend import CpuBackend
from services.perception.cpu.pose import angle_rad, exponential
from tests.unit.services.perception.cpu.raycast import Ball, photograph, transform

STEP_NS = 16_666_667


def film(count):
    """Frames and truths of a die that turns by 3 degrees and moves by 0.5 mm a frame."""
    for number in range(count):
        truth = transform((0.0005 * number, 0.0, 0.42), (1.0, 2.0, 0.3), 40.0 + 3.0 * number)
        rng = np.random.default_rng(number)
        frame = photograph(truth, background=(90, 120, 60), number=number, t_ns=STEP_NS * number, rng=rng)
        yield frame, truth


FILM = list(film(8))


def errors(estimate, truth):
    found = estimate.T_camera_die
    return np.degrees(angle_rad(found[:3, :3], truth[:3, :3])), 1e3 * np.linalg.norm((found - truth)[:3, 3])


@pytest.fixture
def following():
    """A backend that has found the die in the first frame and followed it to the fourth."""
    backend = CpuBackend(DIE)
    assert backend.track(FILM[0][0]).state is PoseState.SEARCHING
    backend.adopt(backend.register(FILM[0][0]))
    for frame, _ in FILM[1:4]:
        backend.track(frame)
    return backend


def test_searches_finds_and_follows(following):
    for frame, truth in FILM[4:]:
        estimate = following.track(frame)
        assert isinstance(estimate, PoseEstimate)
        assert (estimate.state, estimate.claimed) == (PoseState.TRACKING, True)
        assert estimate.t_ns == frame.t_ns
        assert estimate.frame_number == frame.frame_number
        turned, shifted = errors(estimate, truth)
        assert turned < 1.5
        assert shifted < 1.0
        assert estimate.label_posterior[0] > 0.9
        assert np.isclose(estimate.label_posterior.sum(), 1.0)
        assert np.linalg.eigvalsh(estimate.covariance).min() > 0


def hidden(frame):
    """The same moment with a board before the camera."""
    board = np.full_like(frame.colour, 120), np.full_like(frame.depth, 2500)
    return replace(frame, colour=board[0], depth=board[1])


def test_a_hidden_die_is_lost_without_a_false_claim_and_found_again(following):
    answers = [following.track(hidden(frame)) for frame, _ in FILM[4:8]]
    assert not any(isinstance(a, PoseEstimate) and a.claimed for a in answers)
    assert answers[-1].state is PoseState.LOST
    later = [replace(f, colour_time_ns=t, depth_time_ns=t, frame_number=n) for f, n, t in again()]
    back = [following.track(frame) for frame in later]
    assert isinstance(back[-1], PoseEstimate)
    assert back[-1].claimed


def again():
    """The last frames once more, as frames 8 to 10: the die stayed where it was hidden."""
    return [(FILM[5][0], number, STEP_NS * number) for number in range(8, 11)]


def test_blind_depth_is_never_a_claim(following):
    blind = [replace(frame, depth=np.zeros_like(frame.depth)) for frame, _ in FILM[4:8]]
    answers = [following.track(frame) for frame in blind]
    assert not any(isinstance(a, PoseEstimate) and a.claimed for a in answers)
    assert isinstance(answers[-1], Unseen)
    assert isinstance(CpuBackend(DIE).register(blind[0]), Unseen)


def test_a_die_whose_faces_are_not_known_is_followed_but_not_told_until_they_are():
    """Of a 2 alone there are two readings; when the die turns and shows another face, there is one."""
    backend, answers = CpuBackend(DIE), []
    for number in range(8):
        truth = shown(2, turned_deg=3.0 * number)
        rng = np.random.default_rng(number)
        frame = photograph(truth, background=(90, 120, 60), number=number, t_ns=STEP_NS * number, rng=rng)
        answers.append((backend.track(frame), truth))
        if number == 0:
            found = backend.register(frame)
            assert found.label_posterior[0] == pytest.approx(0.5, abs=0.05)
            backend.adopt(found)
    told = [isinstance(answer, PoseEstimate) for answer, _ in answers]
    assert not any(told[:4])
    assert answers[3][0].state is PoseState.SEARCHING
    assert "could be several of its faces" in answers[3][0].message
    assert all(told[-2:])
    assert answers[-1][0].claimed
    for answer, truth in (one for one, seen in zip(answers, told, strict=True) if seen):
        assert errors(answer, truth)[0] < 3.0


def shown(number, turned_deg):
    """A pose (4, 4) with a face to the camera, but for a turn about the picture's upward axis."""
    toward = DIE.turned(number, (0.0, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0))
    axis, half = toward[1:] / np.linalg.norm(toward[1:]), np.arccos(toward[0])
    truth = transform((0.0, 0.0, 0.42), axis, 2 * np.degrees(half))
    truth[:3, :3] = exponential(np.array([0.0, np.radians(turned_deg), 0.0])) @ truth[:3, :3]
    return truth


def test_reset_forgets(following):
    following.reset()
    answer = following.track(FILM[4][0])
    assert isinstance(answer, Unseen)
    assert answer.state is PoseState.SEARCHING


def test_reset_forgets_what_was_learned_too(following):
    """A search afterwards is that of a backend which has never seen a picture."""
    following.reset()
    found, first = following.register(FILM[4][0]), CpuBackend(DIE).register(FILM[4][0])
    assert np.array_equal(found.T_camera_die, first.T_camera_die)
    assert np.array_equal(found.covariance, first.covariance)


def test_a_reset_while_a_search_begins_does_no_harm(following):
    """The other thread forgets the die just after this one has seen that it is known."""

    class Interrupted(CpuBackend):
        @property
        def _seen(self):
            known, self.known = self.known, None
            return known

        @_seen.setter
        def _seen(self, value):
            self.known = value

    backend = Interrupted(DIE)
    backend._seen = following._seen
    assert isinstance(backend.register(FILM[4][0]), PoseEstimate)


def test_nothing_is_found_where_no_die_is():
    away = transform((0.0, 0.0, -1.0), (1.0, 0.0, 0.0), 0.0)
    frame = photograph(away, [Ball((0.0, 0.02, 0.4), 0.03)], rng=np.random.default_rng(0))
    answer = CpuBackend(DIE).register(frame)
    assert isinstance(answer, Unseen)
    assert answer.state is PoseState.SEARCHING


def test_registration_changes_nothing(following):
    frame = FILM[4][0]
    following.register(frame)
    other = CpuBackend(DIE)
    other.track(FILM[0][0])
    other.adopt(other.register(FILM[0][0]))
    for earlier, _ in FILM[1:4]:
        other.track(earlier)
    assert np.array_equal(following.track(frame).T_camera_die, other.track(frame).T_camera_die)


def merged(first, second):
    """What a camera sees of two scenes at once."""
    nearer = second.depth < first.depth
    colour = np.where(nearer[..., None], second.colour, first.colour)
    return replace(first, colour=colour, depth=np.minimum(first.depth, second.depth))


def test_a_second_die_in_view_is_not_taken_for_the_first(following):
    """It is alike and nearer to the camera; when the first is hidden, no claim goes over to it."""
    beside = photograph(transform((0.09, 0.01, 0.38), (0.2, 1.0, 0.5), 70.0), rng=np.random.default_rng(1))
    both = [merged(frame, beside) for frame, _ in FILM[4:]]
    for frame, (_, truth) in zip(both, FILM[4:], strict=True):
        estimate = following.track(frame)
        assert isinstance(estimate, PoseEstimate)
        assert estimate.claimed
        assert errors(estimate, truth)[1] < 1.0
    gone = [
        replace(beside, colour_time_ns=t_ns, depth_time_ns=t_ns, frame_number=number)
        for number, t_ns in ((n, STEP_NS * n) for n in range(8, 12))
    ]
    answers = [following.track(frame) for frame in gone]
    assert not any(isinstance(a, PoseEstimate) and a.claimed for a in answers)
    assert (answers[-1].state, answers[-1].message) == (PoseState.LOST, "lost the die")

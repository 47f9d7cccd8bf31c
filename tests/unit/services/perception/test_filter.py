"""The pose filter against least squares, exact motions, slips, jumps, gaps and clocks that run backwards."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common import geometry
from services.perception import rigid
from services.perception.filter import FilterConfig, Measured, PoseFilter, Verdict

PERIOD_NS = 33_333_333
EXACT = np.diag([1e-8] * 3 + [1e-6] * 3)
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
unit_vectors = arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)


def seen(number, position=(0.1, 0.0, 0.2), rotation=IDENTITY, covariance=EXACT):
    return Measured(number * PERIOD_NS, np.array(position, float), np.array(rotation, float), covariance)


def turned(axis, angle_rad, rotation=IDENTITY):
    axis = np.asarray(axis, float)
    return geometry.multiply(geometry.from_axis_angle(axis, np.asarray(angle_rad)), rotation)


def followed(measurements, **options):
    pose_filter = PoseFilter(FilterConfig(**options))
    return pose_filter, [pose_filter.update(measured) for measured in measurements]


@settings(max_examples=25, deadline=None)
@given(unit_vectors, st.floats(-3, 3), arrays(np.float64, 3, elements=st.floats(-0.3, 0.3)), st.booleans())
def test_constant_velocity_is_predicted_exactly(axis, rate, velocity, flip):
    """After enough frames; the sign in which a backend gives quaternions does not matter."""

    def truth(number):
        t = number * PERIOD_NS / 1e9
        sign = -1.0 if flip and number % 2 else 1.0
        return seen(number, 0.1 + velocity * t, sign * turned(axis, rate * t))

    vague = 1e4 * EXACT  # the last pose: it hardly moves what was predicted for its time
    elsewhere = truth(42)
    elsewhere = replace(elsewhere, position=elsewhere.position + 0.003, covariance=vague)
    measured = [*(truth(n) for n in range(40)), elsewhere]
    pose_filter, verdicts = followed(measured, acceleration_m_s2=1e-3)
    assert verdicts == [Verdict.STARTED] + [Verdict.ACCEPTED] * 40
    expected, told = truth(42), pose_filter.pose()
    assert told.position == pytest.approx(expected.position, abs=2e-5)
    assert geometry.angle(told.rotation, expected.rotation) < 2e-3


def test_without_accelerations_it_is_the_straight_line_of_least_squares():
    """An independent answer: numpy's fit of a line through the same noisy positions."""
    rng = np.random.default_rng(3)
    numbers = np.arange(30)
    heights = 0.2 + 0.004 * numbers + rng.normal(0, 0.001, 30)
    noisy = np.diag([1e-6] * 3 + [1e-4] * 3)
    quiet = {"acceleration_m_s2": 1e-9, "noise_m": 1e-9, "speed_m_s": 1e3}
    pose_filter, _ = followed(
        [seen(n, (0, 0, h), covariance=noisy) for n, h in zip(numbers, heights, strict=True)], **quiet
    )
    slope, intercept = np.polyfit(numbers, heights, 1)
    assert pose_filter.pose().position[2] == pytest.approx(intercept + slope * 29, abs=1e-6)


def test_the_covariance_is_honest():
    """Normalised squared errors of 6 degrees of freedom, over many runs with the noise that was told."""
    rng = np.random.default_rng(5)
    noise = np.diag([4e-7] * 3 + [4e-4] * 3)
    config = {"noise_m": 1e-6, "noise_rad": 1e-6, "acceleration_m_s2": 0.1, "acceleration_rad_s2": 1.0}
    squares = []
    for _ in range(60):
        pose_filter = PoseFilter(FilterConfig(**config))
        for number in range(12):
            error = rng.multivariate_normal(np.zeros(6), noise)
            rotation = turned(error[3:], np.linalg.norm(error[3:]))
            pose_filter.update(seen(number, 0.1 + error[:3], rotation, noise))
        told = pose_filter.pose()
        residual = np.concatenate([told.position - 0.1, geometry.to_rotation_vector(told.rotation)])
        squares.append(residual @ np.linalg.solve(told.covariance, residual))
    # Lower than 6: the truth does not accelerate at all. 60 runs: one deviation is 0.45.
    assert 3.0 < np.mean(squares) < 6.5


@pytest.mark.parametrize("axis", np.eye(3))
def test_a_slipped_label_is_refused_and_leaves_no_trace(axis):
    still = [seen(n) for n in range(5)]
    pose_filter, verdicts = followed([*still, seen(5, rotation=turned(axis, np.pi / 2)), seen(6)])
    undisturbed, _ = followed([*still, seen(6)])
    assert verdicts[-2:] == [Verdict.OUTLIER, Verdict.ACCEPTED]
    assert np.array_equal(pose_filter.pose().rotation, undisturbed.pose().rotation)
    assert np.array_equal(pose_filter.pose().covariance, undisturbed.pose().covariance)


def test_the_second_pose_ever_may_not_slip_either():
    _, verdicts = followed([seen(0), seen(1, rotation=turned((0, 0, 1), np.pi / 2))])
    assert verdicts == [Verdict.STARTED, Verdict.OUTLIER]


def test_outliers_that_agree_become_the_truth_and_those_that_do_not_never_do():
    jump = turned((0, 0, 1), np.pi / 2)
    pose_filter, verdicts = followed(
        [*(seen(n) for n in range(5)), *(seen(n, rotation=jump) for n in range(5, 9))]
    )
    assert verdicts[5:] == [Verdict.OUTLIER] * 3 + [Verdict.STARTED]
    assert geometry.angle(pose_filter.pose().rotation, jump) < 1e-3
    wild = [seen(n, rotation=turned(np.eye(3)[n % 3], np.pi / 2)) for n in range(20, 24)]
    assert followed([*(seen(n) for n in range(20)), *wild])[1][20:] == [Verdict.OUTLIER] * 4


def test_time_that_does_not_go_on_is_refused_and_changes_nothing():
    pose_filter, _ = followed([seen(0), seen(1), seen(2)])
    before = pose_filter.pose()
    assert pose_filter.update(seen(2, (9, 9, 9))) is Verdict.BACKWARDS
    assert pose_filter.update(seen(1, (9, 9, 9))) is Verdict.BACKWARDS
    assert pose_filter.pose() is before


def test_nothing_is_predicted_before_the_first_pose_nor_after_a_gap():
    pose_filter, _ = followed([])
    assert pose_filter.pose() is None
    for gap_ns, verdict in ((300_000_000, Verdict.ACCEPTED), (300_000_001, Verdict.STARTED)):
        later = replace(seen(0), t_ns=gap_ns)
        assert followed([seen(0), later], max_gap_s=0.3)[1] == [Verdict.STARTED, verdict]


def test_after_a_gap_it_starts_where_the_die_is_now_on_the_same_side_of_the_sign():
    there = -turned((1, 0, 0), 0.4)
    pose_filter, verdicts = followed([seen(0), seen(100, (0.3, 0, 0), there)])
    assert verdicts == [Verdict.STARTED, Verdict.STARTED]
    assert pose_filter.pose().position == pytest.approx([0.3, 0, 0])
    assert np.array_equal(pose_filter.pose().rotation, -there)


def test_quaternions_never_jump_to_the_other_sign():
    told = []
    pose_filter = PoseFilter(FilterConfig())
    for number in range(200):  # more than one full turn
        rotation = turned((0, 0.6, 0.8), 0.04 * number)
        pose_filter.update(seen(number, rotation=rotation if number % 3 else -rotation))
        told.append(pose_filter.pose().rotation)
    assert (np.sum(np.diff(told, axis=0) ** 2, axis=1) < 0.01).all()


def test_uncertain_poses_pull_less():
    start = [seen(n) for n in range(5)]
    beside = seen(5, (0.1005, 0.0, 0.2))
    sure = followed([*start, beside])[0].pose().position[0]
    unsure = followed([*start, replace(beside, covariance=100 * EXACT)])[0].pose().position[0]
    assert 0.1 < unsure < sure < 0.1005


def test_it_says_the_same_in_any_frame():
    """Filtering commutes with a change of frame: here and in the palm's frame the poses are the same."""
    rng = np.random.default_rng(7)
    palm = rigid.join((0.3, -0.2, 0.5), geometry.normalise(rng.normal(size=4)))
    here, there = PoseFilter(FilterConfig()), PoseFilter(FilterConfig())
    for number in range(10):
        factor = rng.normal(size=(6, 6))
        measured = seen(number, 0.1 + rng.normal(0, 1e-3, 3), turned((0, 1, 0), 0.02 * number), EXACT)
        measured = replace(measured, covariance=1e-7 * factor @ factor.T)
        position, rotation = rigid.split(palm @ rigid.join(measured.position, measured.rotation))
        covariance = rigid.turn_covariance(palm[:3, :3], measured.covariance)
        assert here.update(measured) is there.update(Measured(measured.t_ns, position, rotation, covariance))
    expected = palm @ rigid.join(here.pose().position, here.pose().rotation)
    assert rigid.join(there.pose().position, there.pose().rotation) == pytest.approx(expected, abs=1e-9)

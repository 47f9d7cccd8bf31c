"""Pose errors against closed forms, and against what each of them is blind to."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.perception import metrics
from common import geometry
from common.die import CUBE_ROTATIONS, DIE

POINTS = metrics.surface_points(DIE)


def pose(axis=(0.0, 0.0, 1.0), angle_deg=0.0, position=(0.0, 0.0, 0.42)):
    q = geometry.from_axis_angle(np.array(axis, float), np.array(np.radians(angle_deg)))
    made = np.eye(4)
    made[:3, :3] = geometry.rotate(q, np.eye(3)).T
    made[:3, 3] = position
    return made


def one(function, estimated, true, *more):
    return function(estimated[None], true[None], *more)[0]


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 1.0, 90.0, 179.9, 180.0])
def test_rotation_error_is_the_angle(angle_deg):
    turned = pose((1.0, 2.0, -1.0), angle_deg)[:3, :3]
    measured = np.degrees(metrics.rotation_error_rad(turned, np.eye(3)))
    assert measured == pytest.approx(angle_deg, rel=1e-6, abs=1e-9)


@given(
    st.integers(0, 23),
    st.floats(0.0, 40.0),
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1),
)
def test_a_slipped_labelling_is_told_from_a_turn(label, angle_deg, axis):
    true = pose((0.3, -1.0, 0.2), 77.0)
    turned = pose(axis, angle_deg, (0, 0, 0)) @ true
    slipped = turned.copy()
    slipped[:3, :3] = turned[:3, :3] @ CUBE_ROTATIONS[label]
    errors = np.degrees(one(metrics.rotation_errors_rad, slipped, true))
    assert errors.min() == pytest.approx(angle_deg, abs=1e-6)
    # Column l is the error if R_true · C_l were the truth: C_label gives the turn alone.
    assert errors[label] == pytest.approx(angle_deg, abs=1e-6)


def test_one_face_too_far():
    """The figures of a 90 degree slip: ADD 60 mm for corners, nothing for what knows the symmetry."""
    slipped = pose()
    slipped[:3, :3] = CUBE_ROTATIONS[[np.allclose(c @ [0, 0, 1], [1, 0, 0]) for c in CUBE_ROTATIONS]][0]
    corners = DIE.half_m * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    assert one(metrics.mssd_m, slipped, pose(), corners) == pytest.approx(0.0, abs=1e-12)
    assert one(metrics.add_s_m, slipped, pose(), corners) == pytest.approx(0.0, abs=1e-12)
    assert one(metrics.add_m, pose((0, 0, 1), 90.0), pose(), corners) == pytest.approx(0.060, abs=1e-9)
    assert one(metrics.add_s_m, slipped, pose(), POINTS) == pytest.approx(0.0, abs=1e-12)


def test_a_shift_is_the_same_for_all():
    moved = pose(position=(0.002, 0.0, 0.42))
    assert one(metrics.translation_error_m, moved, pose()) == pytest.approx(0.002)
    assert one(metrics.add_m, moved, pose(), POINTS) == pytest.approx(0.002)
    assert one(metrics.mssd_m, moved, pose(), POINTS) == pytest.approx(0.002)


def test_add_s_asks_for_the_nearest_point():
    """Moved by one step of the grid, only the last row and the two faces across have no counterpart."""
    step = 2 * (DIE.half_m - DIE.corner_radius_m) / 6
    moved = pose(position=(step, 0.0, 0.42))
    assert one(metrics.add_m, moved, pose(), POINTS) == pytest.approx(step)
    assert 0.2 * step < one(metrics.add_s_m, moved, pose(), POINTS) < 0.5 * step


def test_mssd_is_the_farthest_point_under_the_best_symmetry():
    angle = np.radians(5.0)
    turned = pose((0, 0, 1), 90.0 + 5.0)
    corner = np.array([[DIE.half_m, DIE.half_m, DIE.half_m]])
    all_corners = np.concatenate([corner @ c.T for c in CUBE_ROTATIONS])
    expected = 2 * np.sin(angle / 2) * np.sqrt(2) * DIE.half_m
    assert one(metrics.mssd_m, turned, pose(), all_corners) == pytest.approx(expected)

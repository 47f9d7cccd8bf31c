"""Rigid motions: group axioms, and the small ones against their definition."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from services.perception.cpu.pose import (
    Pose,
    angle_rad,
    exponential,
    from_matrix,
    logarithm,
    motion,
    moved,
    orthonormal,
    to_matrix,
)

unit = st.floats(-1, 1)
vectors = st.tuples(unit, unit, unit).map(np.array)


@given(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3), st.floats(0, np.pi - 1e-3))
def test_logarithm_undoes_exponential(axis, angle):
    turn = angle * axis / np.linalg.norm(axis)
    rotation = exponential(turn)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.allclose(logarithm(rotation), turn, atol=1e-7)
    assert np.isclose(angle_rad(rotation, np.eye(3)), angle, atol=1e-7)


def test_half_a_turn_has_its_axis():
    turn = logarithm(np.diag([-1.0, 1.0, -1.0]))
    assert np.allclose(np.abs(turn), [0, np.pi, 0])


@given(vectors, vectors, vectors, vectors)
def test_motion_leads_from_one_pose_to_the_other(turn, shift, other_turn, other_shift):
    source, target = Pose(exponential(turn), shift), Pose(exponential(other_turn), other_shift)
    reached = moved(source, motion(source, target))
    assert np.allclose(to_matrix(reached), to_matrix(target), atol=1e-6)


def test_motion_is_a_shift_and_a_turn_about_the_centre():
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 0.4]))
    after = moved(pose, np.array([0.01, 0.0, 0.0, 0.0, 0.0, np.pi / 2]))
    assert np.allclose(after.translation, [0.01, 0.0, 0.4])
    assert np.allclose(after.rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])


@given(vectors, st.integers(0, 1000))
def test_orthonormal_removes_rounding(turn, seed):
    rotation = exponential(turn)
    off = rotation + 1e-6 * np.random.default_rng(seed).normal(size=(3, 3))
    assert np.allclose(orthonormal(off), rotation, atol=1e-5)
    assert np.isclose(np.linalg.det(orthonormal(off)), 1.0)
    assert np.allclose(from_matrix(to_matrix(Pose(rotation, turn))).rotation, rotation)

"""Transforms apart and together, at half turns as anywhere."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common import geometry
from common.die import CUBE_ROTATIONS
from services.perception import rigid

numbers = st.floats(-1, 1, width=64)
quaternions = (
    arrays(np.float64, 4, elements=numbers).filter(lambda q: np.linalg.norm(q) > 0.1).map(geometry.normalise)
)
positions = arrays(np.float64, 3, elements=numbers)
few = settings(max_examples=50, deadline=None)


@few
@given(positions, quaternions)
def test_split_undoes_join(position, rotation):
    told_position, told_rotation = rigid.split(rigid.join(position, rotation))
    assert np.array_equal(told_position, position)
    assert told_rotation[0] >= 0
    assert geometry.angle(told_rotation, rotation) < 1e-7


@few
@given(quaternions)
def test_matrices_are_those_of_opencv(rotation):
    expected = cv2.Rodrigues(geometry.to_rotation_vector(rotation))[0]
    assert rigid.to_matrix(rotation) == pytest.approx(expected, abs=1e-9)


@few
@given(positions, quaternions)
def test_inverse_undoes(position, rotation):
    transform = rigid.join(position, rotation)
    assert rigid.inverse(transform) @ transform == pytest.approx(np.eye(4), abs=1e-12)


@pytest.mark.parametrize("matrix", CUBE_ROTATIONS)
def test_quarter_and_half_turns_are_exact(matrix):
    rotation = rigid.from_matrix(matrix)
    assert rotation[0] >= 0 and np.linalg.norm(rotation) == pytest.approx(1.0, abs=1e-12)
    assert rigid.to_matrix(rotation) == pytest.approx(matrix, abs=1e-12)


def test_a_covariance_turns_with_its_frame():
    """A deviation along one axis only is, seen from a frame turned by 90 degrees, along another."""
    quarter = rigid.to_matrix(geometry.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.asarray(np.pi / 2)))
    turned = rigid.turn_covariance(quarter, np.diag([4.0, 1, 1, 9, 1, 1]))
    assert turned == pytest.approx(np.diag([1.0, 4, 1, 1, 9, 1]), abs=1e-12)

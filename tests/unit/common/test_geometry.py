"""Quaternion algebra as properties, the same for numpy and torch, with finite gradients everywhere."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common import geometry

numbers = st.floats(-1, 1, allow_nan=False, width=64)
quaternions = (
    arrays(np.float64, 4, elements=numbers).filter(lambda q: np.linalg.norm(q) > 0.1).map(geometry.normalise)
)
vectors = arrays(np.float64, 3, elements=numbers)
few = settings(max_examples=60, deadline=None)


@few
@given(quaternions)
def test_conjugate_is_the_inverse(q):
    assert np.allclose(geometry.multiply(q, geometry.conjugate(q)), [1, 0, 0, 0], atol=1e-12)


@few
@given(quaternions, quaternions, vectors)
def test_product_rotates_by_the_right_factor_first(p, q, v):
    twice = geometry.rotate(p, geometry.rotate(q, v))
    assert np.allclose(geometry.rotate(geometry.multiply(p, q), v), twice, atol=1e-12)


@few
@given(quaternions, vectors)
def test_rotation_keeps_lengths(q, v):
    assert np.linalg.norm(geometry.rotate(q, v)) == pytest.approx(np.linalg.norm(v), abs=1e-12)


@few
@given(quaternions, quaternions)
def test_angle_is_geodesic_symmetric_and_blind_to_sign(p, q):
    angle = geometry.angle(p, q)
    assert 0 <= angle <= np.pi + 1e-12
    assert angle == pytest.approx(2 * np.arccos(min(1.0, abs(np.dot(p, q)))), abs=1e-6)
    assert angle == pytest.approx(geometry.angle(q, p), abs=1e-12)
    assert angle == pytest.approx(geometry.angle(-p, q), abs=1e-12)


@few
@given(quaternions, quaternions)
def test_signed_angles_of_both_signs_add_to_a_full_turn(p, q):
    total = geometry.signed_angle(p, q) + geometry.signed_angle(-p, q)
    assert total == pytest.approx(2 * np.pi, abs=1e-12)


@few
@given(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3), st.floats(0, np.pi - 1e-6))
def test_rotation_vector_undoes_axis_and_angle(axis, angle_rad):
    q = geometry.from_axis_angle(axis, np.asarray(angle_rad))
    expected = axis / np.linalg.norm(axis) * angle_rad
    assert np.allclose(geometry.to_rotation_vector(q), expected, atol=1e-9)
    assert np.allclose(geometry.to_rotation_vector(-q), expected, atol=1e-9)


def test_known_quarter_turn_about_z():
    q = geometry.from_axis_angle(np.array([0.0, 0.0, 2.0]), np.array(np.pi / 2))
    assert np.allclose(q, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    assert np.allclose(geometry.rotate(q, np.array([1.0, 0.0, 0.0])), [0, 1, 0])


def test_small_angles_survive_float32():
    axis = np.array([1.0, 0.0, 0.0], np.float32)
    identity = np.array([1, 0, 0, 0], np.float32)
    turned = geometry.from_axis_angle(axis, np.asarray(1e-5, np.float32))
    assert geometry.angle(identity, turned) == pytest.approx(1e-5, rel=1e-3)


def test_normalise_never_divides_by_zero():
    lengths = np.linalg.norm(geometry.normalise(np.array([[0.0, 0, 0, 0], [0, 0, 3, 0]])), axis=-1)
    assert lengths.tolist() == [0.0, 1.0]


CALLS = {
    "normalise": lambda q, v: geometry.normalise(3 * q),
    "multiply": lambda q, v: geometry.multiply(q, q[::-1] if isinstance(q, np.ndarray) else q.flip(0)),
    "rotate": geometry.rotate,
    "rotate_one": lambda q, v: geometry.rotate(q[0], v),
    "angle": lambda q, v: geometry.angle(q, q[0]),
    "signed_angle": lambda q, v: geometry.signed_angle(q, q[0]),
    "from_axis_angle": lambda q, v: geometry.from_axis_angle(v, q[:, 0]),
    "from_one_axis": lambda q, v: geometry.from_axis_angle(v[0], q[:, 0]),
    "to_rotation_vector": lambda q, v: geometry.to_rotation_vector(q),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_torch_and_numpy_agree_and_keep_the_dtype(name, dtype):
    rng = np.random.default_rng(0)
    q = geometry.normalise(rng.normal(size=(7, 4)).astype(dtype))
    v = rng.normal(size=(7, 3)).astype(dtype)
    ours, theirs = CALLS[name](q, v), CALLS[name](torch.from_numpy(q), torch.from_numpy(v))
    assert ours.dtype == dtype
    assert theirs.numpy().dtype == dtype
    assert np.allclose(ours, theirs.numpy(), atol=1e-3 if name == "signed_angle" else 1e-5)


@pytest.mark.parametrize("turn_rad", [0.0, 1e-9, 1.0, np.pi, 2 * np.pi])
def test_gradients_are_finite_even_at_no_turn_and_half_a_turn(turn_rad):
    identity = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64)
    q = geometry.from_axis_angle(torch.tensor([0.0, 1, 0], dtype=torch.float64), torch.tensor(turn_rad))
    q = q.double().requires_grad_()
    loss = geometry.angle(geometry.normalise(q), identity) + geometry.to_rotation_vector(q).sum()
    (gradient,) = torch.autograd.grad(loss, q)
    assert torch.isfinite(gradient).all()


def test_gradient_descends_towards_the_goal():
    goal = geometry.normalise(torch.tensor([0.3, -0.2, 0.9, 0.1], dtype=torch.float64))
    q = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64, requires_grad=True)
    for _ in range(200):
        (gradient,) = torch.autograd.grad(geometry.angle(geometry.normalise(q), goal), q)
        q = (q - 0.01 * gradient).detach().requires_grad_()
    assert geometry.angle(geometry.normalise(q), goal).item() < 0.05


@given(quaternions, quaternions)
def test_a_turn_leads_from_one_rotation_to_the_other(p, q):
    turn = geometry.turn(p, q)
    length = float(np.linalg.norm(turn))
    assert length == pytest.approx(float(geometry.angle(p, q)), abs=1e-6)
    if length > 1e-6:
        there = geometry.multiply(p, geometry.from_axis_angle(turn, np.float64(length)))
        assert float(geometry.angle(there, q)) == pytest.approx(0.0, abs=1e-6)

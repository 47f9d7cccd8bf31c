"""Knots to sequences and back."""

from __future__ import annotations

import pytest
import torch

from services.planner.knots import Knots, shift


def random(*shape):
    return torch.rand(shape, generator=torch.Generator().manual_seed(0))


def test_one_knot_is_a_constant_action():
    knots = random(2, 1, 3)
    assert torch.equal(Knots(1, 7, "linear").expand(knots), knots.expand(2, 7, 3))


def test_linear_knots_interpolate():
    sequence = Knots(3, 5, "linear").expand(torch.tensor([[[0.0], [1.0], [-1.0]]]))
    assert sequence.flatten().tolist() == pytest.approx([0.0, 0.5, 1.0, 0.0, -1.0])


def test_held_knots_step():
    sequence = Knots(2, 5, "hold").expand(torch.tensor([[[0.3], [0.7]]]))
    assert sequence.flatten().tolist() == pytest.approx([0.3, 0.3, 0.3, 0.7, 0.7])


@pytest.mark.parametrize("count", [0, 6, 9])
def test_no_knots_or_enough_leave_every_action_free(count):
    actions = random(2, 6, 3)
    knots = Knots(count, 6, "linear")
    assert knots.count == 6
    assert torch.equal(knots.expand(actions), actions)


@pytest.mark.parametrize("kind", ["linear", "hold"])
@pytest.mark.parametrize(("count", "horizon"), [(1, 5), (2, 5), (3, 9), (4, 16), (5, 6), (2, 1)])
def test_sampling_undoes_expanding(kind, count, horizon):
    knots = Knots(count, horizon, kind)
    values = random(2, knots.count, 3) * 2 - 1
    sequence = knots.expand(values)
    assert sequence.shape == (2, horizon, 3)
    assert sequence.abs().max() <= 1.0
    if kind == "hold" or (horizon - 1) % max(knots.count - 1, 1) == 0:
        assert torch.allclose(knots.sample(sequence), values, atol=1e-6)


def test_shift_fills_with_zero_or_the_last_action():
    sequence = torch.arange(1.0, 5.0).reshape(1, 4, 1)
    assert shift(sequence, 1, 4, "zero").flatten().tolist() == [2, 3, 4, 0]
    assert shift(sequence, 2, 4, "repeat").flatten().tolist() == [3, 4, 4, 4]
    assert shift(sequence, 9, 3, "repeat").flatten().tolist() == [4, 4, 4]
    assert shift(sequence, 1, 2, "zero").flatten().tolist() == [2, 3]

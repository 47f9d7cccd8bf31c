"""Standardisation over episodes that arrive one by one equals standardisation over all of them."""

import numpy as np
import torch

from common.model.normaliser import Normaliser, RunningMoments


def episodes():
    rng = np.random.default_rng(0)
    return [
        (
            (rng.normal(size=(n, 3)) * [1e-4, 1.0, 50.0] + [5.0, 0.0, -200.0]).astype(np.float32),
            rng.normal(size=(n, 3)).astype(np.float32),
        )
        for n in (50, 7, 120)
    ]


def test_incremental_statistics_equal_those_of_all_rows():
    moments = RunningMoments(3, 3)
    for episode in episodes():
        moments.update(*episode)
    columns = [np.concatenate(part).astype(np.float64) for part in zip(*episodes(), strict=True)]
    found = moments.normaliser().tensors()
    expected = [value for rows in columns for value in (rows.mean(axis=0), rows.std(axis=0))]
    for tensor, value in zip(found.values(), expected, strict=True):
        assert tensor.dtype == torch.float32
        np.testing.assert_allclose(tensor.numpy(), value, rtol=2e-6, atol=1e-9)


def test_constant_dimension_has_deviation_one():
    states = np.full((40, 3), 0.1, np.float32)
    moments = RunningMoments(3, 3)
    for _ in range(3):
        moments.update(states, np.zeros((40, 3), np.float32))
    normaliser = moments.normaliser()
    assert torch.equal(normaliser.input_std, torch.ones(3))
    assert torch.equal(normaliser.standardised(torch.full((3,), 0.1)), torch.zeros(3))


def test_identity_changes_nothing():
    normaliser = Normaliser.identity(3, 3)
    inputs = torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(normaliser.standardised(inputs), inputs)


def test_nothing_seen_is_the_identity():
    found, identity = RunningMoments(3, 3).normaliser().tensors(), Normaliser.identity(3, 3).tensors()
    assert all(torch.equal(found[name], identity[name]) for name in identity)

"""The batched network is what B separate networks would be, and predicts honest deviations."""

import torch
from torch.nn.functional import silu, softplus

from common.model.config import ModelConfig
from common.model.ensemble import Ensemble
from common.model.masks import MaskPool

CONFIG = ModelConfig(members=3, hidden=(16, 8), dropout=0.3)


def member_forward(ensemble, b, x, masks):
    h = x
    for layer in range(len(ensemble.weights) - 1):
        h = silu(h @ ensemble.weights[layer][b] + ensemble.biases[layer][b]) * masks[layer][b]
    out = h @ ensemble.weights[-1][b] + ensemble.biases[-1][b]
    mean, raw = out[:, : ensemble.state_dim], out[:, ensemble.state_dim :]
    below = ensemble.max_log_var - softplus(ensemble.max_log_var - raw)
    return mean, ensemble.min_log_var + softplus(below - ensemble.min_log_var)


def test_batched_forward_equals_a_loop_over_members():
    generator = torch.Generator().manual_seed(0)
    ensemble = Ensemble.create(CONFIG, 5, 4, generator)
    masks = MaskPool.draw(3, 4, CONFIG.hidden, 0.3, generator).pick(7, generator)
    x = torch.randn(3, 7, 5, generator=generator)
    mean, log_var = ensemble(x, masks)
    for b in range(3):
        expected_mean, expected_log_var = member_forward(ensemble, b, x[b], masks)
        torch.testing.assert_close(mean[b], expected_mean)
        torch.testing.assert_close(log_var[b], expected_log_var)


def test_no_masks_equals_masks_of_ones():
    generator = torch.Generator().manual_seed(0)
    ensemble = Ensemble.create(CONFIG, 5, 4, generator)
    x = torch.randn(3, 7, 5, generator=generator)
    ones = [torch.ones(3, 7, width) for width in CONFIG.hidden]
    assert all(torch.equal(a, b) for a, b in zip(ensemble(x), ensemble(x, ones), strict=True))


def test_log_variance_stays_within_the_bounds():
    ensemble = Ensemble.create(CONFIG, 5, 4, torch.Generator().manual_seed(0))
    clamped = ensemble.clamp(torch.tensor([[-1e6, -3.0, 3.0, 1e6]]))
    assert (clamped >= -10.0).all()
    # The lower clamp is applied last and lifts the upper limit by softplus(-(max - min)).
    assert (clamped <= 0.5 + 1e-4).all()


def test_initial_weights_are_truncated_at_two_deviations():
    ensemble = Ensemble.create(ModelConfig(hidden=(512,)), 100, 4, torch.Generator().manual_seed(0))
    deviation = 0.5 / 100**0.5
    weight = ensemble.weights[0]
    assert weight.abs().max() <= 2 * deviation
    # A normal cut at 2 sigma keeps 0.8796 of its deviation.
    assert abs(weight.std() / (0.8796 * deviation) - 1) < 0.01
    assert all(not bias.any() for bias in ensemble.biases)


def test_members_start_different_and_a_seed_repeats_them():
    first = Ensemble.create(CONFIG, 5, 4, torch.Generator().manual_seed(1))
    again = Ensemble.create(CONFIG, 5, 4, torch.Generator().manual_seed(1))
    assert not torch.equal(first.weights[0][0], first.weights[0][1])
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), again.parameters(), strict=True))

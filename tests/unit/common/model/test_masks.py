"""Mask pools: Bernoulli, drawn once, separate for training and planning, picked per row."""

import pytest
import torch

from common.model.masks import MaskPool


def pool(seed=0, size=5):
    return MaskPool.draw(3, size, (40, 30), 0.3, torch.Generator().manual_seed(seed))


def test_masks_are_zeros_and_ones_without_rescaling():
    drawn = MaskPool.draw(5, 50, (512,), 0.05, torch.Generator().manual_seed(0)).layers[0]
    assert set(drawn.unique().tolist()) == {0.0, 1.0}
    assert abs(float(drawn.mean()) - 0.95) < 0.002


def test_two_pools_of_one_generator_are_different():
    generator = torch.Generator().manual_seed(0)
    train = MaskPool.draw(3, 5, (40,), 0.3, generator)
    plan = MaskPool.draw(3, 5, (40,), 0.3, generator)
    rows = {tuple(row.tolist()) for row in train.layers[0].flatten(0, 1)}
    assert all(tuple(row.tolist()) not in rows for row in plan.layers[0].flatten(0, 1))


def test_each_picked_row_is_one_particle_of_its_own_member_in_every_layer():
    masks = pool()
    picked = masks.pick(64, torch.Generator().manual_seed(1))
    assert [tuple(layer.shape) for layer in picked] == [(3, 64, 40), (3, 64, 30)]
    for b in range(3):
        members = torch.cat([layer[b] for layer in masks.layers], dim=-1)
        rows = torch.cat([layer[b] for layer in picked], dim=-1)
        hits = (rows[:, None, :] == members[None]).all(dim=-1)
        assert (hits.sum(dim=1) == 1).all()
        assert hits.any(dim=0).all()


def test_particles_are_the_same_at_every_call():
    masks = pool()
    first, again = masks.particles(4), masks.particles(4)
    assert [tuple(layer.shape) for layer in first] == [(3, 4, 40), (3, 4, 30)]
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def test_more_particles_than_masks_are_refused():
    with pytest.raises(ValueError, match="6 particles wanted from a pool of 5"):
        pool().particles(6)


def test_no_dropout_keeps_everything():
    drawn = MaskPool.draw(2, 3, (8,), 0.0, torch.Generator().manual_seed(0))
    assert bool((drawn.layers[0] == 1).all())

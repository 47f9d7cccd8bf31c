"""The motion that points impart to a body is the least-squares one."""

import numpy as np
import torch

from common.model.rigid_fit import Motion, carried, cross

C, N, MASS, SPIN = 4, 6, 0.7, 1.3


def drawn(*shape):
    return torch.tensor(np.random.default_rng(sum(shape)).normal(size=shape))


def test_it_solves_the_least_squares_problem():
    weight, arm, moved = drawn(C, N).abs(), drawn(3, C, N), drawn(3, C, N) + 1.0
    drift = Motion(drawn(3, N), drawn(3, N + 1)[:, 1:])
    found = carried(weight, arm, moved, drift, (MASS, SPIN))
    for n in range(N):
        rows, wanted = [], []
        for c in range(C):
            at, firm = arm[:, c, n].numpy(), float(weight[c, n]) ** 0.5
            turns = np.stack([np.cross(axis, at) for axis in np.eye(3)], axis=1)
            rows.append(firm * np.hstack((np.eye(3), turns)))
            wanted.append(firm * moved[:, c, n].numpy())
        own = np.repeat(np.sqrt([MASS, SPIN]), 3)
        system = np.vstack((*rows, np.diag(own)))
        right = np.concatenate((*wanted, own * np.concatenate((drift.shift[:, n], drift.turn[:, n]))))
        exact = np.linalg.lstsq(system, right, rcond=None)[0]
        np.testing.assert_allclose(torch.cat((found.shift[:, n], found.turn[:, n])), exact, atol=1e-12)


def test_untouched_it_drifts_on():
    drift = Motion(drawn(3, N), drawn(3, N))
    found = carried(torch.zeros(C, N), drawn(3, C, N), drawn(3, C, N), drift, (MASS, SPIN))
    for ours, own in zip(found, drift, strict=True):
        torch.testing.assert_close(ours, own)


def test_the_vector_product_is_torchs():
    a, b = drawn(3, C, N), drawn(3, N + C)[:, :N][:, None]
    torch.testing.assert_close(cross(a, b.expand_as(a)), torch.linalg.cross(a, b.expand_as(a), dim=0))

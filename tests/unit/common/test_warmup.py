"""Warm-up actions are bounded, repeatable, and held as long as their kind says."""

from itertools import islice

import numpy as np
import pytest

from common.warmup import WarmupActions


def take(kind, seed, episode=0, n=50):
    return np.array(list(islice(WarmupActions(kind, 20, seed, episode), n)))


@pytest.mark.parametrize("kind", ["uniform", "mix"])
def test_actions_are_bounded_and_repeatable(kind):
    first = take(kind, 7, 3)
    assert first.dtype == np.float32
    assert first.shape == (50, 20)
    assert np.abs(first).max() <= 1
    assert np.array_equal(first, take(kind, 7, 3))
    assert not np.array_equal(first, take(kind, 7, 4))
    assert not np.array_equal(first, take(kind, 8, 3))


def test_earlier_actions_do_not_change_under_the_reader():
    generator = WarmupActions("uniform", 20, 0)
    first = next(generator)
    copy = first.copy()
    next(generator)
    assert np.array_equal(first, copy)


def test_uniform_draws_each_joint_anew():
    actions = take("uniform", 0, n=2000)
    assert (np.diff(actions, axis=0) != 0).all()
    assert np.abs(actions.mean()) < 0.02
    assert actions.std() == pytest.approx(1 / np.sqrt(3), rel=0.02)


def test_mix_holds_with_one_of_four_chances_per_episode():
    chances = [(np.diff(take("mix", 0, episode, 200), axis=0) != 0).mean() for episode in range(60)]
    nearest = {min((1.0, 0.3, 0.1, 0.05), key=lambda p: abs(p - c)) for c in chances}
    assert nearest == {1.0, 0.3, 0.1, 0.05}
    assert all(min(abs(p - c) for p in nearest) < 0.03 for c in chances)


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="uniform, mix"):
        WarmupActions("brownian", 20, 0)  # type: ignore[arg-type]

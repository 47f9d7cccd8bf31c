"""The label filter against Bayes by hand, and against pictures of every labelling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.die import CUBE_ROTATIONS, DIE
from services.perception.cpu.labels import LABELS, bayes, log_likelihood, relabelled, unexplained
from services.perception.cpu.surface import surface_of

SURFACE = surface_of(DIE)
labels = st.integers(0, LABELS - 1)


def test_bayes_by_hand():
    posterior = bayes(np.array([0.5, 0.3, 0.2]), np.log([0.2, 0.6, 0.2]), slip=0.0)
    assert np.allclose(posterior, [0.10 / 0.32, 0.18 / 0.32, 0.04 / 0.32])
    slipped = bayes(np.array([1.0, 0.0, 0.0]), np.zeros(3), slip=0.3)
    assert np.allclose(slipped, [0.8, 0.1, 0.1])


def test_likelihood_by_hand():
    chance = log_likelihood(np.array([9.0, 99.0, 1e9]), noise=1.0, worth=4.0, most=6.0)
    assert chance == pytest.approx([0.0, -2 * np.log(10.0), -6.0])


@given(labels, labels)
def test_relabelling_keeps_the_truth(truth, turn):
    """A posterior that is sure of `truth` is sure of the same rotation in the turned frame."""
    before = np.eye(LABELS)[truth]
    after = int(np.argmax(relabelled(before, turn)))
    assert np.array_equal(CUBE_ROTATIONS[turn] @ CUBE_ROTATIONS[after], CUBE_ROTATIONS[truth])


@given(labels, st.floats(20, 200), st.floats(0, 100))
def test_each_labelling_explains_its_own_picture(truth, contrast, offset):
    faces = [0, 1, 2]
    levels = SURFACE.sharp.levels[:, faces]
    light = np.array([1.0, 0.7, 0.4])[:, None]
    left, total = unexplained(light * contrast * levels[truth] + offset, levels, np.ones(levels[0].shape))
    others = np.delete(left, truth)
    assert left[truth] == pytest.approx(0.0, abs=1e-6 * total)
    assert others.min() > 0.1 * total


@pytest.mark.parametrize(("face", "alike"), [(1, 4), (2, 2), (3, 2), (4, 4), (5, 4), (6, 2)])
def test_one_face_alone_is_truly_ambiguous(face, alike):
    """Seen alone, 1, 4 and 5 look the same four ways round, 2, 3 and 6 two ways."""
    levels = SURFACE.sharp.levels[:, [face - 1]]
    left, total = unexplained(100 * levels[0], levels, np.ones(levels[0].shape))
    assert (left < 1e-6 * total).sum() == alike


def test_what_is_not_trusted_does_not_count():
    levels = SURFACE.sharp.levels[:, [2]]
    seen, trust = 100 * levels[0], np.ones(levels[0].shape)
    seen[0, :100], trust[0, :100] = 255.0, 0.0
    assert unexplained(seen, levels, trust)[0][0] == pytest.approx(0.0, abs=1e-6)

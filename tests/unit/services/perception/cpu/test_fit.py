"""Refinement against exact pictures whose pose is known."""

import numpy as np
import pytest

from common.dice import APPEARANCES
from common.die import CUBE_ROTATIONS, DIE
from services.perception.cpu.colours import colours_of
from services.perception.cpu.fit import Fitter, Tuning
from services.perception.cpu.pose import angle_rad, from_matrix, moved
from services.perception.cpu.surface import surface_of
from services.perception.cpu.view import colours_around
from tests.unit.services.perception.cpu.raycast import Ball, photograph, transform

TRUTH = transform((0.01, -0.02, 0.42), (1.0, 2.0, 0.3), 40.0)
FINGER = Ball((0.03, 0.0, 0.38), 0.015)


def fitter_for(die, frame, truth):
    """A fitter that knows the colours around the die, as after registration."""
    fitter = Fitter(surface_of(die), colours_of(die), Tuning())
    view = fitter.view(frame, from_matrix(truth), 40)
    around = colours_around(view, truth[:3, 3], 0.06)
    return Fitter(fitter.surface, fitter.colours.learned(around[:0], around), fitter.tuning)


@pytest.mark.parametrize("look", ["white", "black", "red", "worn"])
def test_a_pose_is_found_from_nearby(look):
    die, rng = APPEARANCES[look].die, np.random.default_rng(3)
    frame = photograph(TRUTH, [FINGER], die=die, background=(90, 120, 60), rng=rng)
    fitter, truth = fitter_for(die, frame, TRUTH), from_matrix(TRUTH)
    for _ in range(4):
        start = moved(truth, rng.normal(size=6) * ([0.003] * 3 + [0.05] * 3))
        fit = fitter.fit(start, None, fitter.view(frame, start))
        assert np.degrees(angle_rad(fit.pose.rotation, truth.rotation)) < 1.0
        assert np.linalg.norm(fit.pose.translation - truth.translation) < 0.0007
        assert not fit.poor


def test_the_label_is_the_one_that_was_painted():
    frame = photograph(TRUTH, rng=np.random.default_rng(0))
    fitter, truth = fitter_for(DIE, frame, TRUTH), from_matrix(TRUTH)
    for label in (1, 7, 23):
        slipped = truth._replace(rotation=truth.rotation @ CUBE_ROTATIONS[label].T)
        fit = fitter.fit(slipped, None, fitter.view(frame, slipped), alone=True)
        assert np.argmax(fit.likelihood) == label


def test_quality_says_what_is_wrong():
    frame = photograph(TRUTH, [FINGER], rng=np.random.default_rng(1))
    fitter, truth = fitter_for(DIE, frame, TRUTH), from_matrix(TRUTH)
    good = fitter.fit(truth, None, fitter.view(frame, truth)).quality
    assert good.consistent > 0.8
    assert 0.05 < good.occluded < 0.3
    assert good.violated < 0.01
    assert good.pip_ncc > 0.95
    beside = moved(truth, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    missed = fitter.fit(beside, None, fitter.view(frame, beside))
    assert missed.quality.violated > 0.6  # the wall is far behind
    assert missed.misplaced

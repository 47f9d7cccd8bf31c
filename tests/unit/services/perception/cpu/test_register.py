"""Registration: axes from normals, planes, seeds, and whole poses against exact pictures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.die import CUBE_ROTATIONS, DIE
from services.perception.cpu.colours import colours_of
from services.perception.cpu.fit import Fitter, Tuning
from services.perception.cpu.normals import Oriented, cube_axes, planes_along, spread_rotations
from services.perception.cpu.pose import Pose, angle_rad, exponential, from_matrix
from services.perception.cpu.register import Before, register
from services.perception.cpu.seeds import find_seeds
from services.perception.cpu.surface import surface_of
from tests.unit.services.perception.cpu.raycast import Ball, K, photograph, transform

FITTER = Fitter(surface_of(DIE), colours_of(DIE), Tuning())
STARTS = spread_rotations(24)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_axes_are_found_among_noisy_normals_and_outliers(seed):
    draw = np.random.default_rng(seed)
    truth = exponential(draw.normal(size=3))
    normals = np.concatenate([np.repeat(truth.T, 80, axis=0), draw.normal(size=(60, 3))])
    normals[:240] += 0.08 * draw.normal(size=(240, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rotation, share = cube_axes(normals, STARTS)
    nearest = min(angle_rad(rotation @ turn, truth) for turn in CUBE_ROTATIONS)
    assert np.degrees(nearest) < 2.5
    assert share > 0.6


def test_planes_are_where_points_are_dense():
    draw = np.random.default_rng(0)
    heights = np.concatenate([draw.normal(0.40, 0.001, 200), draw.normal(0.43, 0.001, 90), [0.5]])
    points = np.column_stack([draw.uniform(-0.03, 0.03, (291, 2)), heights])
    cloud = Oriented(points, np.tile([0.0, 0.0, 1.0], (291, 1)))
    assert planes_along(np.array([0.0, 0.0, 1.0]), cloud, 40) == pytest.approx([0.40, 0.43], abs=5e-4)
    assert planes_along(np.array([1.0, 0.0, 0.0]), cloud, 40) == []


@pytest.mark.parametrize("number", range(4))
def test_the_die_is_found_wherever_it_is(number):
    draw = np.random.default_rng([5, number])
    place = draw.uniform(-0.04, 0.04, 3) + np.array([0, 0, 0.42])
    truth = transform(place, (1.0, draw.normal(), 0.7), 40 + 90 * number)
    finger = Ball(tuple(truth[:3, 3] + [0.02, 0.02, -0.05]), 0.01)
    frame = photograph(truth, [finger], background=(90, 120, 60), rng=draw)
    found = register(frame, FITTER)
    assert found is not None
    pose, true = found.fit.pose, from_matrix(truth)
    nearest = min(range(24), key=lambda k: angle_rad(pose.rotation @ CUBE_ROTATIONS[k], true.rotation))
    assert np.degrees(angle_rad(pose.rotation @ CUBE_ROTATIONS[nearest], true.rotation)) < 1.5
    assert np.linalg.norm(pose.translation - true.translation) < 0.001
    assert found.posterior[nearest] > 0.9 * found.posterior.max()  # a tie only where the picture has one


def facing(number, turned_deg=0.0):
    """A pose (4, 4) that shows the camera one face and nothing else of the die."""
    toward = DIE.turned(number, (0.0, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0))
    truth = transform(
        (0.0, 0.0, 0.42), toward[1:] / np.linalg.norm(toward[1:]), 2 * np.degrees(np.arccos(toward[0]))
    )
    truth[:3, :3] = exponential(np.array([0.0, 0.0, np.radians(turned_deg)])) @ truth[:3, :3]
    return truth


@settings(max_examples=8, deadline=None)
@given(st.sampled_from((2, 3, 6)), st.integers(0, 180), st.integers(0, 10**6))
def test_a_die_that_shows_one_face_is_found_however_it_is_turned(number, turned_deg, seed):
    """Nothing but its pips and its outline say how; faces 2, 3 and 6 look the same two ways round."""
    truth = facing(number, turned_deg)
    frame = photograph(truth, background=(90, 120, 60), rng=np.random.default_rng(seed))
    found = register(frame, FITTER)
    assert found is not None
    assert np.linalg.norm(found.fit.pose.translation - truth[:3, 3]) < 0.001
    turns = [angle_rad(found.fit.pose.rotation @ turn, truth[:3, :3]) for turn in CUBE_ROTATIONS]
    assert np.degrees(min(turns)) < 2.0
    assert found.posterior[int(np.argmin(turns))] == pytest.approx(0.5, abs=0.05)


def test_what_was_known_before_breaks_a_tie():
    """Face 1 alone looks the same four ways round."""
    truth = facing(1)
    frame = photograph(truth, background=(90, 120, 60), rng=np.random.default_rng(2))
    alone = register(frame, FITTER)
    assert alone is not None
    assert alone.posterior.max() < 0.4
    true = from_matrix(truth)
    turned = Pose(exponential(np.array([0.1, 0.2, 0.1])) @ true.rotation, true.translation)
    known = register(frame, FITTER, Before(turned, 0.4))
    assert known is not None
    assert known.posterior[0] > 0.9
    assert np.degrees(angle_rad(known.fit.pose.rotation, true.rotation)) < 1.5


def test_seeds_are_on_the_die_and_obey_the_mask():
    truth = transform((0.03, 0.01, 0.42), (1.0, 2.0, 0.3), 40.0)
    frame = photograph(truth, background=(90, 120, 60))
    seeds = find_seeds(frame, FITTER.colours.odds, DIE.size_m, 3, None)
    assert np.linalg.norm(seeds[0] - truth[:3, 3]) < 0.06
    column = int(K[0, 0] * 0.03 / 0.42 + K[0, 2])
    mask = np.zeros(frame.depth.shape, bool)
    mask[:, : column - 90] = True
    assert len(find_seeds(frame, FITTER.colours.odds, DIE.size_m, 3, mask)) == 0

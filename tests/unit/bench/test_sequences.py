"""Filmed sequences: the truth is true, motion is as asked, fingers stay out of the die, files come back."""

from dataclasses import replace

import numpy as np
import pytest

from bench.perception import library
from bench.perception.library import load, make, suite
from bench.perception.motion import GRIPS, DieMotion, Fingers
from bench.perception.sequence import Spec, Truth, film
from common import geometry
from common.die import DIE, FACES
from services.perception.frames import Frame

OPEN = Spec("open", 3, 2, grip="open", speed_deg_s=100.0)


@pytest.fixture(scope="module")
def filmed():
    return list(film(OPEN))


def seen(frame, truth, points, normals):
    """Pixels (column, row) of those points (P, 3) whose faces look towards the camera, and their depth."""
    placed = points @ truth.T_camera_die[:3, :3].T + truth.T_camera_die[:3, 3]
    towards = np.einsum("pi,pi->p", normals @ truth.T_camera_die[:3, :3].T, -placed)
    shown = towards > 0.5 * np.linalg.norm(placed, axis=1)
    pixels = placed[shown] @ frame.camera_matrix.T
    return np.rint(pixels[:, :2] / pixels[:, 2:]).astype(int), placed[shown, 2], shown


def test_pips_are_where_the_truth_says(filmed):
    pips = np.concatenate([DIE.pips_of(face) for face in range(1, FACES + 1)])
    normals = np.repeat(DIE.normals, np.arange(1, FACES + 1), axis=0)
    rights = np.repeat(DIE.frames[:, 0], np.arange(1, FACES + 1), axis=0)
    for frame, truth in filmed:
        assert truth.occlusion < 0.05
        (dark, _, shown), beside = seen(frame, truth, pips, normals), pips + 1.5 * DIE.pip_radius_m * rights
        bright, *_ = seen(frame, truth, beside, normals)
        assert shown.sum() >= 2
        levels = [frame.colour[at[:, 1], at[:, 0]].mean(axis=-1) for at in (dark, bright)]
        assert (levels[0] < 0.5 * np.median(levels[1])).all()


def test_depth_is_that_of_the_faces(filmed):
    for frame, truth in filmed:
        pixels, distance_m, shown = seen(frame, truth, DIE.half_m * DIE.normals, DIE.normals)
        assert shown.any()
        for (column, row), expected in zip(pixels, distance_m, strict=True):
            window = frame.depth_m()[row - 4 : row + 5, column - 4 : column + 5]
            assert np.median(window[window > 0]) == pytest.approx(expected, abs=0.0025)  # three deviations


def test_the_same_spec_is_the_same_film_and_held_out_is_another(filmed):
    again = next(iter(film(OPEN)))
    assert np.array_equal(again[0].colour, filmed[0][0].colour)
    assert np.array_equal(again[0].depth, filmed[0][0].depth)
    tuning = next(iter(film(replace(OPEN, held_out=False))))
    assert not np.allclose(tuning[1].T_camera_die, filmed[0][1].T_camera_die)


@pytest.mark.parametrize("speed_deg_s", [70.0, 175.0])
def test_the_die_turns_as_fast_as_asked(speed_deg_s):
    speeds = []
    for seed in range(4):
        motion = DieMotion(np.random.default_rng(seed), speed_deg_s, 5.0)
        turns = np.array([motion.pose(t_s)[1] for t_s in np.arange(0.0, 5.0, 1 / 60)])
        speeds += list(60 * np.degrees(geometry.angle(turns[:-1], turns[1:])))
    assert np.mean(speeds) == pytest.approx(speed_deg_s, rel=0.15)
    assert max(speeds) < 2 * speed_deg_s


@pytest.mark.parametrize("grip", GRIPS)
def test_fingers_touch_the_die_and_do_not_cut_into_it(grip):
    rng = np.random.default_rng(5)
    motion = DieMotion(rng, 175.0, 3.0)
    fingers = Fingers(rng, DIE, GRIPS[grip], np.array([0.1, -0.2, 0.35]))
    gaps = []
    for t_s in np.linspace(0.0, 3.0, 25):
        position, rotation = motion.pose(t_s)
        inverse = geometry.conjugate(rotation)
        for rod in fingers.capsules(t_s, position, rotation):
            between = np.linspace(rod.start, rod.end, 25) - position
            # Of a sharp box, that is nearer than the rounded die.
            beyond = np.abs(geometry.rotate(inverse, between)) - DIE.half_m
            outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)
            gaps.append(outside.min() - rod.radius)
    assert min(gaps) > -0.003  # what rounding takes off a corner
    assert np.quantile(gaps, 0.2) < 0.002


def cheap(spec):
    """What a film gives, without drawing one."""
    for number in range(spec.frames):
        picture = np.full((4, 6), 400 + number, np.uint16)
        matrix = np.array([[5.0, 0, 3], [0, 5.0, 2], [0, 0, 1]])
        frame = Frame(np.full((4, 6, 3), 7, np.uint8), picture, 1e-3, matrix, number + 1, number + 1, number)
        yield frame, Truth(np.eye(4) * spec.seed, 0.1 * number)


def test_a_sequence_is_made_once_and_anew_when_its_spec_changes(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(library, "film", lambda spec: made.append(spec) or cheap(spec))
    spec = Spec("some", 2, 3)
    for wanted in (spec, spec, replace(spec, seed=4)):
        read = load(make(wanted, tmp_path))
        assert read.spec == wanted
        assert np.array_equal(read.T_camera_die, np.tile(np.eye(4) * wanted.seed, (3, 1, 1)))
        assert np.allclose(read.occlusion, [0.0, 0.1, 0.2])
        assert [int(frame.depth[0, 0]) for frame in read.frames()] == [400, 401, 402]
    assert made == [spec, replace(spec, seed=4)]
    (tmp_path / "some" / "truth.npz").unlink()
    make(replace(spec, seed=4), tmp_path)
    assert len(made) == 3


def test_tuning_and_held_out_share_no_sequence():
    tuning, held_out = suite("tuning"), suite("held_out")
    assert {spec.held_out for spec in tuning} == {False}
    assert {spec.held_out for spec in held_out + suite("looks")} == {True}
    assert len({spec.seed for spec in held_out}) == 3
    assert not {spec.seed for spec in tuning} & {spec.seed for spec in held_out}
    assert len(suite("looks")) == 15

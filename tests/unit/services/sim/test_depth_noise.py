"""The noise is that of the real sensor: size and correlation as measured, shadow on one side, fixed steps."""

import numpy as np
import pytest

from services.sim.camera import Optics
from services.sim.depth_noise import DepthNoise, DepthSensor

OPTICS = Optics()
F_B = OPTICS.stereo_focal_px * OPTICS.stereo_baseline_m
QUIET = DepthNoise(
    disparity_px=0.0, slow_px=0.0, smear_px=0.0, fattening_px=0, hole_share=0.0, grazing_cosine=0.0
)


def flat(z_m):
    return np.full((OPTICS.height, OPTICS.width), z_m, np.float32)


def sensor(noise, seed=0):
    return DepthSensor(OPTICS, noise, seed, 60.0)


def windows(depth, side=15):
    """Residuals of plane fits to disparity in windows of the stereo camera's grid, as for the recording."""
    step = OPTICS.focal_px / OPTICS.stereo_focal_px
    rows = (np.arange(300) * step).astype(int)
    disparity = F_B / np.where(depth == 0, np.nan, depth * 1e-3)[rows][:, (np.arange(400) * step).astype(int)]
    at = np.indices((side, side)).reshape(2, -1).T
    design = np.column_stack([at, np.ones(side * side)])
    project = np.eye(side * side) - design @ np.linalg.pinv(design)
    for row in range(0, 285, 25):
        for column in range(0, 385, 25):
            window = disparity[row : row + side, column : column + side]
            if not np.isnan(window).any():
                yield (project @ window.ravel()).reshape(side, side)


def test_size_and_correlation_are_those_of_the_recording():
    measured = sensor(DepthNoise())
    residuals = np.array([w for _ in range(4) for w in windows(measured.measure(flat(0.73)))])
    assert len(residuals) > 100
    assert np.sqrt((residuals**2).mean()) == pytest.approx(0.049, abs=0.006)
    lags = [(residuals[:, :, k:] * residuals[:, :, :-k]).mean() for k in (1, 2, 3, 4)]
    correlation = np.array(lags) / (residuals**2).mean()
    # The real one, at 0.6 to 1.0 m: .74 .53 .31 .11.
    assert np.allclose(correlation, [0.74, 0.53, 0.31, 0.11], atol=0.15)


@pytest.mark.parametrize("z_m", [0.3, 0.42, 0.6, 1.5])
def test_without_noise_only_the_steps_are_left(z_m):
    depth = sensor(QUIET).measure(flat(z_m))
    assert len(np.unique(depth)) == 1
    disparity = np.round(F_B / z_m * 32) / 32
    assert depth[0, 0] == round(F_B / disparity * 1000)


def test_nothing_nearer_than_the_sensor_can_see_and_nothing_from_nothing():
    assert not sensor(QUIET).measure(flat(0.17)).any()
    assert not sensor(QUIET).measure(flat(0.0)).any()


def test_the_shadow_lies_left_of_the_nearer_surface():
    picture = flat(0.6)
    picture[:, 300:400] = 0.4
    lost = sensor(QUIET).measure(picture)[240] == 0
    columns = np.flatnonzero(lost)
    assert columns.max() == pytest.approx(299, abs=2)  # the stereo grid is coarser
    width = (F_B / 0.4 - F_B / 0.6) * OPTICS.focal_px / OPTICS.stereo_focal_px
    assert len(columns) == pytest.approx(width, abs=4)


def test_holes_take_their_share_and_the_slow_part_stays():
    noise = DepthNoise(disparity_px=0.0, slow_px=0.1, hole_share=0.05, slow_seconds=1e16)
    measured = sensor(noise)
    first, second = measured.measure(flat(0.6)), measured.measure(flat(0.6))
    assert (first == 0).mean() == pytest.approx(0.05, abs=0.02)
    both = (first > 0) & (second > 0)
    assert np.array_equal(first[both], second[both])
    assert len(np.unique(first[both])) > 3


def test_same_seed_same_noise():
    same = [sensor(DepthNoise(), seed).measure(flat(0.5)) for seed in (1, 1, 2)]
    assert np.array_equal(same[0], same[1])
    assert not np.array_equal(same[0], same[2])


@pytest.mark.parametrize("slope", [-1.5, 0.0, 1.0])
def test_an_oblique_surface_is_where_it_is(slope):
    """The plane z = 0.45 + slope * x, in metres: what grows and smears edges does not move it."""
    u = np.arange(OPTICS.width) - OPTICS.centre_px[0]
    true = np.tile(0.45 / (1 - slope * u / OPTICS.focal_px), (OPTICS.height, 1)).astype(np.float32)
    columns = slice(260, 380)
    edges_alone = DepthNoise(disparity_px=0.0, slow_px=0.0, hole_share=0.0)
    measured = sensor(edges_alone).measure(true)[:, columns] * 1e-3
    assert measured.all()
    assert np.mean(measured - true[:, columns]) == pytest.approx(0.0, abs=5e-5)

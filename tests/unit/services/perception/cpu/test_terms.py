"""Analytic Jacobians against central differences of residuals written here from their definitions."""

import numpy as np
import pytest

from common.die import DIE, Die
from services.perception.cpu.contour_term import border
from services.perception.cpu.depth_term import depth_term
from services.perception.cpu.edges import edge_jacobian, edges_of
from services.perception.cpu.pip_term import fit_light, texture_jacobian
from services.perception.cpu.pose import Pose, from_matrix, moved
from services.perception.cpu.samples import sample_faces
from services.perception.cpu.surface import pip_share, surface_of
from services.perception.cpu.terms import Term, cross, normal, tukey
from services.perception.cpu.view import Camera, View, project
from tests.unit.services.perception.cpu.raycast import transform

CAMERA = Camera(610.0, 615.0, 320.0, 240.0)
POSE = from_matrix(transform((0.02, -0.03, 0.40), (1.0, 2.0, 0.4), 50.0))
SURFACE = surface_of(DIE, grid=8)
STEP = 1e-6


def differences(function):
    """Derivative (N, 6) of function(xi) at 0."""
    columns = [(function(STEP * unit) - function(-STEP * unit)) / (2 * STEP) for unit in np.eye(6)]
    return np.stack(columns, axis=1)


def flat_view(depth_m=0.395):
    picture = np.zeros((480, 640), np.float32)
    return View(
        CAMERA, np.zeros((480, 640, 3), np.uint8), picture, picture, picture, picture + np.float32(depth_m)
    )


def test_depth_jacobian():
    samples = sample_faces(POSE, SURFACE, flat_view())
    measured = samples.seen[:, None] * samples.rays
    normals = SURFACE.normals[samples.faces]

    def residuals(xi):
        pose = moved(POSE, xi)
        local = (measured - pose.translation) @ pose.rotation
        per_face = local.reshape(len(normals), -1, 3)
        return np.einsum("vpi,vi->vp", per_face, normals).ravel() - DIE.half_m

    term = depth_term(samples, SURFACE, POSE.translation, 0.02, 0.001)
    assert np.allclose(term.residuals, residuals(np.zeros(6)), atol=1e-12)
    assert np.allclose(term.jacobian, differences(residuals), atol=1e-8)


@pytest.mark.parametrize("die", [DIE, Die(quarters=(0, 1, 1, 0, 0, 1), right_handed=False)])
def test_pip_jacobian(die):
    surface = surface_of(die, grid=8)
    samples = sample_faces(POSE, surface, flat_view())
    rays = np.column_stack(
        [(samples.pixels - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy), np.ones(len(samples.points))]
    )
    normals = samples.per_sample(surface.normals[samples.faces])

    def seen_levels(xi):
        pose = moved(POSE, xi)
        ways, origin = rays @ pose.rotation, -pose.translation @ pose.rotation
        reach = (die.half_m - normals @ origin) / np.einsum("ij,ij->i", normals, ways)
        return 1 - pip_share(die, origin + reach[:, None] * ways, 0.0025)[0]

    assert np.allclose(seen_levels(np.zeros(6)), surface.soft.levels[0, samples.faces].ravel(), atol=1e-9)
    jacobian = texture_jacobian(samples, surface.soft, POSE.rotation)
    assert np.abs(jacobian).max() > 50  # pips are in sight
    assert np.allclose(jacobian, -differences(seen_levels), atol=1e-3)


def test_edge_jacobian():
    edges = edges_of(POSE, SURFACE, CAMERA)

    def positions(xi):
        moving = moved(Pose(np.eye(3), POSE.translation), xi)
        pixels = project(edges.arms @ moving.rotation.T + moving.translation, CAMERA)
        return np.einsum("ij,ij->i", edges.across, pixels)

    assert np.allclose(edge_jacobian(edges, CAMERA), differences(positions), rtol=1e-6, atol=1e-3)


def gap(pixels):
    """How far (C,) m rays through pixels pass by the die, negative: cut into it."""
    rays = np.column_stack([(pixels - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy), np.ones(len(pixels))])
    points = np.linspace(0.33, 0.47, 4001)[:, None, None] * rays
    over = np.abs((points - POSE.translation) @ POSE.rotation) - (DIE.half_m - DIE.corner_radius_m)
    distance = np.linalg.norm(np.maximum(over, 0), axis=-1) + np.minimum(over.max(-1), 0)
    return distance.min(axis=0) - DIE.corner_radius_m


def test_the_outline_is_where_rays_graze_the_die():
    edges = edges_of(POSE, SURFACE, CAMERA)
    rim = edges.far < 0
    assert rim.sum() == 6 * SURFACE.edges.shape[1]  # three faces in sight: a hexagon
    assert np.allclose(gap(edges.pixels[rim]), 0.0, atol=2e-6)
    assert (gap((edges.pixels + edges.across)[rim]) > 5e-4).all()
    assert (gap((edges.pixels - edges.across)[rim]) < -1e-4).all()


def test_creases_lead_from_one_face_to_the_other():
    edges = edges_of(POSE, SURFACE, CAMERA)
    crease = edges.far >= 0
    assert crease.sum() == 3 * SURFACE.edges.shape[1]
    middles = project(POSE.translation + DIE.half_m * (SURFACE.normals @ POSE.rotation.T), CAMERA)
    from_near_to_far = (middles[edges.far] - middles[edges.near])[crease]
    assert (np.einsum("ij,ij->i", from_near_to_far, edges.across[crease]) > 0).all()


def test_border_of_a_clean_step_and_of_nothing():
    step = np.where(np.arange(-6, 7) <= 2, 3.0, -3.0)[None]  # die up to and including +2
    mean, variance = border(step, 1.0)
    assert mean[0] == pytest.approx(2.5, abs=1e-2)
    assert variance[0] < 0.02
    mean, variance = border(np.zeros((1, 13)), 1.0)
    assert mean[0] == pytest.approx(0.0)
    assert variance[0] == pytest.approx((14**2 - 1) / 12)  # uniform over 14 places


def test_light_by_hand():
    levels = np.array([[0.0, 1.0, 1.0, 0.0]])
    light = fit_light(np.array([[20.0, 120.0, 120.0, 999.0]]), levels, np.array([[1.0, 1.0, 1.0, 0.0]]))
    assert light.pip[0] == pytest.approx(20.0)
    assert light.contrast[0] == pytest.approx(100.0)
    inverted = fit_light(np.array([[120.0, 20.0, 20.0, 120.0]]), levels, np.ones((1, 4)))
    assert inverted.contrast[0] == 0.0
    assert inverted.pip[0] == pytest.approx(70.0)


def test_normal_equations_and_weights():
    term = Term(np.array([1.0, 2.0]), np.eye(6)[:2], np.array([4.0, 0.25]))
    equations = normal(term)
    assert np.array_equal(np.diag(equations.matrix), [4.0, 0.25, 0, 0, 0, 0])
    assert np.array_equal(equations.vector, [4.0, 0.5, 0, 0, 0, 0])
    assert np.allclose(tukey(np.array([0.0, 1.0, 2.0, 3.0]), 2.0), [1.0, 0.5625, 0.0, 0.0])
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    assert np.allclose(cross(a, b), np.cross(a, b))

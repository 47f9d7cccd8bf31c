"""The die is a die: faces, handedness, pips where the picture has them, a closed rounded surface."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from common import geometry
from common.die import CUBE_ROTATIONS, DIE, FACES

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
OUT = (1.0, 0.0, 0.0)
faces = pytest.mark.parametrize("face", range(1, FACES + 1))


def test_opposite_faces_sum_to_seven():
    assert np.array_equal(DIE.normals[::-1], -DIE.normals)
    assert np.array_equal(np.abs(DIE.normals[:3]), np.eye(3))


@pytest.mark.parametrize(("right_handed", "sense"), [(True, 1.0), (False, -1.0)])
def test_handedness_is_the_sense_of_1_2_3(right_handed, sense):
    one, two, three = replace(DIE, right_handed=right_handed).normals[:3]
    assert np.cross(one, two) @ three == sense


@faces
def test_frames_are_right_handed_and_look_outward(face):
    right, up, out = DIE.frames[face - 1]
    assert np.array_equal(np.cross(right, up), out)
    assert np.array_equal(out, DIE.normals[face - 1])


@faces
def test_a_face_shows_as_many_pips_as_it_is_called(face):
    image = DIE.face_image(face, 96)
    pips = DIE.pips_of(face)
    assert pips.shape == (face, 3)
    assert np.allclose(pips @ DIE.normals[face - 1], DIE.half_m)
    body, pip = np.mean(DIE.body_rgb), np.mean(DIE.pip_rgb)
    dark = (body - image.mean()) / (body - pip) * DIE.size_m**2
    assert dark == pytest.approx(face * np.pi * DIE.pip_radius_m**2, rel=0.02)
    assert np.array_equal(image[0, 0], DIE.body_rgb)


@faces
def test_the_picture_on_the_surface_is_dark_exactly_at_the_pips(face):
    mesh, atlas = DIE.mesh(), DIE.atlas(96)
    count = len(mesh.vertices) // FACES
    own = slice(count * (face - 1), count * face)
    # Texture coordinates are affine on a flat face: fit them there, then look up where pips are and are not.
    flat = np.isclose(mesh.vertices[own] @ DIE.normals[face - 1], DIE.half_m)
    at = np.column_stack([mesh.vertices[own][flat], np.ones(flat.sum())])
    affine = np.linalg.lstsq(at, mesh.uv[own][flat], rcond=None)[0]
    pips = DIE.pips_of(face)
    beside = pips + DIE.pip_radius_m * 1.3 * DIE.frames[face - 1][0]
    for points, dark in ((pips, True), (beside, False)):
        u, v = (np.column_stack([points, np.ones(len(points))]) @ affine).T
        levels = atlas[(v * atlas.shape[0]).astype(int), (u * atlas.shape[1]).astype(int)].mean(axis=-1)
        assert np.array_equal(levels < 128, np.full(face, dark))


def test_the_surface_is_closed_and_rounded():
    mesh = DIE.mesh()
    solid = trimesh.Trimesh(mesh.vertices, mesh.triangles)
    solid.merge_vertices()
    assert solid.is_watertight
    assert np.allclose(solid.bounds, [[-DIE.half_m] * 3, [DIE.half_m] * 3])
    assert 0.98 < solid.volume / DIE.size_m**3 < 0.995  # positive: triangles look outward
    reach = np.linalg.norm(mesh.vertices, axis=1).max()
    inner = DIE.half_m - DIE.corner_radius_m
    assert reach == pytest.approx(np.sqrt(3) * inner + DIE.corner_radius_m)


@faces
def test_a_turned_die_shows_that_face(face):
    start = geometry.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(0.3))
    for q in DIE.turns(face, OUT, start, 5):
        assert np.linalg.norm(q) == pytest.approx(1.0)
        assert np.allclose(geometry.rotate(q, DIE.normals[face - 1]), OUT)
        assert DIE.uppermost(q, OUT) == face
    nearest = DIE.turned(face, OUT, start)
    angle = {1: 0.0, 6: np.pi}.get(face, np.pi / 2)
    assert geometry.angle(nearest, start) == pytest.approx(angle, abs=1e-6)


def test_inertia_is_that_of_a_cube():
    box = trimesh.creation.box([DIE.size_m] * 3)
    box.density = DIE.mass_kg / box.volume
    assert np.allclose(np.diag(box.moment_inertia), DIE.inertia)


def test_cube_rotations_are_the_group_of_the_cube():
    matrices = CUBE_ROTATIONS
    assert matrices.shape == (24, 3, 3)
    assert np.array_equal(matrices[0], np.eye(3))
    assert np.array_equal(np.linalg.det(matrices), np.ones(24))
    assert len({m.tobytes() for m in matrices + 0.0}) == 24
    products = {m.tobytes() for m in np.einsum("aij,bjk->abik", matrices, matrices).reshape(-1, 3, 3) + 0.0}
    assert products == {m.tobytes() for m in matrices + 0.0}


@faces
def test_quarters_turn_the_pips_counter_clockwise(face):
    turned = replace(DIE, quarters=(1,) * FACES)
    assert np.array_equal(turned.face_image(face, 64), np.rot90(DIE.face_image(face, 64)))
    assert {1: True, 4: True, 5: True}.get(face, False) == np.array_equal(
        turned.face_image(face, 64), DIE.face_image(face, 64)
    )


def test_polarity_follows_the_colours():
    assert not DIE.light_pips
    assert replace(DIE, body_rgb=(170, 30, 30), pip_rgb=(200, 200, 200)).light_pips

"""The exported die is whole, of the right size, and looks the same from each side as the die does."""

import numpy as np
import pytest
import trimesh

from common.dice import APPEARANCES
from common.die import FACES
from services.perception.mesh_file import main, textured_mesh

RED = APPEARANCES["red"].die


def loaded(path):
    return trimesh.load(path, force="mesh", process=False)


@pytest.mark.parametrize(("option", "unit"), [((), 1.0), (("--millimetres",), 1000.0)])
def test_size_and_closedness_survive_the_file(tmp_path, option, unit):
    path = tmp_path / "die.obj"
    assert main([str(path), "--die", "red", *option]) == 0
    mesh = loaded(path)
    assert np.allclose(mesh.bounds, unit * RED.half_m * np.array([[-1] * 3, [1] * 3]), atol=1e-6 * unit)
    mesh.merge_vertices(merge_tex=True)
    assert mesh.is_watertight


def test_pips_are_where_the_die_has_them(tmp_path):
    """Colours are looked up as a renderer would: by the file's texture coordinates, v from the lower edge."""
    path = tmp_path / "die.obj"
    textured_mesh(RED).export(path)
    mesh = loaded(path)
    picture = np.asarray(mesh.visual.material.image.convert("RGB"))
    for face in range(1, FACES + 1):
        pips = RED.pips_of(face)
        beside = pips + 1.3 * RED.pip_radius_m * RED.frames[face - 1][0]
        for points, expected in ((pips, RED.pip_rgb), (beside, RED.body_rgb)):
            near, _, triangle = trimesh.proximity.closest_point_naive(mesh, points)
            weights = trimesh.triangles.points_to_barycentric(mesh.triangles[triangle], near)
            u, v = np.einsum("pc,pcx->xp", weights, mesh.visual.uv[mesh.faces[triangle]])
            rows, columns = ((1 - v) * picture.shape[0]).astype(int), (u * picture.shape[1]).astype(int)
            assert np.abs(picture[rows, columns].astype(int) - expected).max() <= 8


def test_an_unknown_die_is_named(tmp_path, capsys):
    assert main([str(tmp_path / "die.obj"), "--die", "purple"]) == 2
    assert "purple" in capsys.readouterr().err

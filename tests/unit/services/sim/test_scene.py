"""The exported scene is small, well formed, lies where the simulator's geoms lie, and shows rotations."""

import numpy as np
import pytest

from common import geometry
from services.sim.plant import ENV_IDS, ShadowHandPlant
from services.sim.scene import export_scene, primitive


@pytest.fixture(scope="module", params=ENV_IDS)
def plant(request):
    return ShadowHandPlant(request.param)


def test_meshes_are_well_formed_and_small(plant):
    scene = export_scene(plant)
    assert scene.nbytes < 2_000_000
    for mesh in (mesh for body in scene.bodies for mesh in body.meshes):
        assert (mesh.vertices.dtype, mesh.triangles.dtype, mesh.rgba.dtype) == ("float32", "int32", "float32")
        assert mesh.vertices.shape[1] == mesh.triangles.shape[1] == 3
        assert np.isfinite(mesh.vertices).all()
        assert mesh.triangles.min() == 0
        assert mesh.triangles.max() < len(mesh.vertices)
        assert mesh.rgba.shape == (4,)
        assert ((mesh.rgba >= 0) & (mesh.rgba <= 1)).all()


def test_every_shown_body_has_a_pose(plant):
    scene = export_scene(plant)
    names = {body.name for body in scene.bodies}
    assert {"palm", "ffdistal", "thdistal"} <= names <= set(plant.bodies()[0])
    assert "target" not in names
    assert len([name for name in names if name.startswith("goal")]) == (
        5 if plant.task.name == "reach" else 1
    )


def test_meshes_lie_exactly_where_the_simulator_has_them(plant):
    names, positions, quaternions = plant.bodies()
    poses = {n: (p, q) for n, p, q in zip(names, positions, quaternions, strict=True)}
    shown = {body.name: body.meshes for body in export_scene(plant).bodies}
    model, data, compared = plant.model, plant.data, 0
    for geom in map(model.geom, range(model.ngeom)):
        if geom.group[0] != 1 or geom.dataid[0] < 0:
            continue
        mesh, body = model.mesh(geom.dataid[0]), model.body(geom.bodyid[0]).name.removeprefix("robot0:")
        local = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
        expected = local @ data.geom_xmat[geom.id].reshape(3, 3).T + data.geom_xpos[geom.id]
        (ours,) = shown[body]
        position, quaternion = poses[body]
        assert np.allclose(
            geometry.rotate(quaternion[None], ours.vertices.astype(float)) + position, expected, atol=1e-6
        )
        compared += 1
    assert compared == 23  # of 25 visual shapes, two are boxes


def test_an_object_has_six_sides_of_different_colour(plant):
    shown = {body.name: body.meshes for body in export_scene(plant).bodies}
    if "object" not in shown:
        pytest.skip("no object in this task")
    assert len({tuple(mesh.rgba) for mesh in shown["object"]}) == 6
    assert all(mesh.rgba[3] < 1 for mesh in shown["goal"])
    spans = np.concatenate([mesh.vertices for mesh in shown["object"]])
    size = plant.model.geom("object").size
    assert np.allclose(spans.max(axis=0), size, rtol=0.02)
    first = shown["object"][0].vertices.mean(axis=0)
    assert np.argmax(np.abs(first)) == 0
    assert first[0] > 0


@pytest.mark.parametrize(
    ("kind", "size", "half_extents"),
    [
        ("mjGEOM_BOX", [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
        ("mjGEOM_SPHERE", [0.1, 0, 0], [0.1, 0.1, 0.1]),
        ("mjGEOM_ELLIPSOID", [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]),
        ("mjGEOM_CAPSULE", [0.1, 0.2, 0], [0.1, 0.1, 0.3]),
    ],
)
def test_primitives_have_mujocos_size(kind, size, half_extents):
    bounds = primitive(kind, np.array(size)).bounds
    assert np.allclose(bounds, [-np.array(half_extents), half_extents], rtol=0.05, atol=1e-6)


def test_an_unknown_shape_is_refused():
    with pytest.raises(ValueError, match="mjGEOM_PLANE"):
        primitive("mjGEOM_PLANE", np.ones(3))

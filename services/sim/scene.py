"""The simulated scene as triangle meshes, exported once, for a viewer that knows nothing of MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from common import geometry
from common.die import DIE, FACES
from services.sim.interface import Plant

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs

# MuJoCo's own default: a geom of this colour takes that of its material.
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
# Collision shapes of the hand are in group 4, the environment's own goal object in group 2; neither is shown.
_SHOWN_GROUPS = (0, 1)
# Radius of a fingertip goal and the colours of ff, mf, rf, lf, th, as in the environment's reach.xml.
_GOAL_RADIUS_M = 0.005
_FINGER_RGB = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1))
# Without its texture an egg looks the same from all sides, so each side (+x -x +y -y +z -z) has a colour.
_SIDE_RGB = (
    (0.9, 0.2, 0.2),
    (1.0, 0.6, 0.2),
    (0.2, 0.7, 0.3),
    (0.9, 0.9, 0.3),
    (0.2, 0.4, 0.9),
    (0.9, 0.9, 0.9),
)
_GOAL_ALPHA = 0.4
_DIE_BODY = "die"
_PIP_THICKNESS_M = 0.0004
_DIE_GOAL_TINT = (0.55, 0.85, 0.65, 1.0)  # opaque: pips of the far side would show through


@dataclass(frozen=True)
class SceneMesh:
    """Vertices (V, 3) float32, m, body frame; triangles (F, 3) int32; rgba (4,) float32 in [0, 1]."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    rgba: NDArray[np.float32]


@dataclass(frozen=True)
class SceneBody:
    """The meshes that move with one body, or goal marker, of a plant's `bodies`."""

    name: str
    meshes: tuple[SceneMesh, ...]


@dataclass(frozen=True)
class Scene:
    """Everything visible except the floor."""

    bodies: tuple[SceneBody, ...]

    @property
    def nbytes(self) -> int:
        """Size of all arrays, bytes."""
        meshes = (mesh for body in self.bodies for mesh in body.meshes)
        return sum(m.vertices.nbytes + m.triangles.nbytes + m.rgba.nbytes for m in meshes)


def export_scene(plant: Plant) -> Scene:
    """The scene of `plant`; body names are those of `plant.bodies()` that have something to show."""
    meshes: dict[str, list[SceneMesh]] = {}
    for geom in map(plant.model.geom, range(plant.model.ngeom)):
        body = plant.model.body(geom.bodyid[0]).name.removeprefix("robot0:")
        if body != "world" and geom.group[0] in _SHOWN_GROUPS and geom.name != "object_hidden":
            meshes.setdefault(body, []).extend(_geom_meshes(plant.model, geom))
    bodies = [SceneBody(name, tuple(parts)) for name, parts in meshes.items()]
    return Scene((*bodies, *_goal_bodies(plant, meshes)))


def _goal_bodies(plant: Plant, meshes: dict[str, list[SceneMesh]]) -> Iterator[SceneBody]:
    if "object" in meshes:
        yield SceneBody("goal", tuple(_transparent(mesh) for mesh in meshes["object"]))
        return
    if _DIE_BODY in meshes:
        yield SceneBody("goal", tuple(_tinted(mesh) for mesh in meshes[_DIE_BODY]))
        return
    for finger, rgb in zip(plant.task.finger_names, _FINGER_RGB, strict=True):
        marker = trimesh.creation.icosphere(subdivisions=2, radius=_GOAL_RADIUS_M)
        yield SceneBody(f"goal_{finger}", (_mesh(marker.vertices, marker.faces, (*rgb, 1.0)),))


def _geom_meshes(model: Any, geom: Any) -> list[SceneMesh]:
    if model.body(geom.bodyid[0]).name == _DIE_BODY:
        return list(_die())
    vertices, triangles = _surface(model, geom)
    placed = geometry.rotate(geom.quat[None, :], vertices) + geom.pos
    if model.body(geom.bodyid[0]).name == "object":
        return list(_sides(placed, triangles, geom.size))
    return [_mesh(placed, triangles, _rgba(model, geom))]


def _surface(model: Any, geom: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices (V, 3), m, geom frame, and triangles (F, 3). Raises ValueError for an unknown shape."""
    if geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(geom.dataid[0])
        first_vertex, first_face = mesh.vertadr[0], mesh.faceadr[0]
        vertices = model.mesh_vert[first_vertex : first_vertex + mesh.vertnum[0]]
        return vertices, model.mesh_face[first_face : first_face + mesh.facenum[0]]
    shape = primitive(mujoco.mjtGeom(geom.type[0]).name, geom.size)
    return np.asarray(shape.vertices), np.asarray(shape.faces)


def primitive(kind: str, size: NDArray[Any]) -> trimesh.Trimesh:
    """A MuJoCo primitive (`mjGEOM_...`) of MuJoCo `size`, m, centred. Raises ValueError for another kind."""
    if kind == "mjGEOM_BOX":
        return trimesh.creation.box(extents=2 * size)
    if kind == "mjGEOM_CAPSULE":
        capsule = trimesh.creation.capsule(radius=size[0], height=2 * size[1], count=(12, 12))
        capsule.apply_translation(-capsule.bounds.mean(axis=0))
        return capsule
    if kind in ("mjGEOM_SPHERE", "mjGEOM_ELLIPSOID"):
        sphere = trimesh.creation.icosphere(subdivisions=3)
        sphere.vertices *= size if kind == "mjGEOM_ELLIPSOID" else size[0]
        return sphere
    raise ValueError(f"no mesh for a {kind}")


def _sides(vertices: NDArray[Any], triangles: NDArray[Any], size: NDArray[Any]) -> Iterator[SceneMesh]:
    """One mesh for each of the six sides; a triangle belongs to the axis that its centre lies along."""
    centres = vertices[triangles].mean(axis=1) / size
    axis = np.abs(centres).argmax(axis=1)
    negative = np.take_along_axis(centres, axis[:, None], axis=1)[:, 0] < 0
    for side, rgb in enumerate(_SIDE_RGB):
        chosen = triangles[2 * axis + negative == side]
        used, renumbered = np.unique(chosen, return_inverse=True)
        yield _mesh(vertices[used], renumbered.reshape(-1, 3), (*rgb, 1.0))


def _die() -> Iterator[SceneMesh]:
    """The die's body, and its pips as discs: a scene mesh has a colour, not a picture."""
    body = DIE.mesh()
    yield _mesh(body.vertices, body.triangles, _opaque(DIE.body_rgb))
    pips: list[trimesh.Trimesh] = []
    for face in range(1, FACES + 1):
        disc = trimesh.creation.cylinder(DIE.pip_radius_m, 2 * _PIP_THICKNESS_M, sections=16)
        disc.vertices = disc.vertices @ DIE.frames[face - 1]
        pips += [disc.copy().apply_translation(centre) for centre in DIE.pips_of(face)]
    discs: Any = trimesh.util.concatenate(pips)
    yield _mesh(discs.vertices, discs.faces, _opaque(DIE.pip_rgb))


def _opaque(rgb: tuple[int, int, int]) -> tuple[float, ...]:
    return (*(level / 255 for level in rgb), 1.0)


def _rgba(model: Any, geom: Any) -> NDArray[Any]:
    uses_material = geom.matid[0] >= 0 and np.allclose(geom.rgba, _DEFAULT_RGBA)
    return model.mat_rgba[geom.matid[0]] if uses_material else geom.rgba


def _transparent(mesh: SceneMesh) -> SceneMesh:
    return replace(mesh, rgba=np.array([*mesh.rgba[:3], _GOAL_ALPHA], np.float32))


def _tinted(mesh: SceneMesh) -> SceneMesh:
    return replace(mesh, rgba=mesh.rgba * np.array(_DIE_GOAL_TINT, np.float32))


def _mesh(vertices: NDArray[Any], triangles: NDArray[Any], rgba: Any) -> SceneMesh:
    return SceneMesh(
        np.ascontiguousarray(vertices, np.float32),
        np.ascontiguousarray(triangles, np.int32),
        np.asarray(rgba, np.float32),
    )

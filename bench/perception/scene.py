"""The place where sequences are filmed: table, lamps and the die as a MuJoCo model, fingers drawn on top."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import NDArray

from bench.perception.looks import TABLE_PIXELS, Lighting, Palette, worn_atlas
from bench.perception.motion import Capsule
from common.dice import Appearance
from services.sim.camera import Optics, SceneCamera

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs
Float64 = NDArray[np.float64]

DIE = "die"
_DIE_GROUP = 1
TABLE_BELOW_M = 0.13  # under the die's middle
PALM_BELOW_M = 0.062  # more than the distance of a corner from the middle
_PALM_HALF_M = (0.055, 0.05, 0.008)
_NO_TURN = np.eye(3).ravel()


class FilmSet:
    """One look of table, lamps, die and hand; draws any arrangement of die and fingers."""

    def __init__(
        self, appearance: Appearance, lighting: Lighting, palette: Palette, rng: np.random.Generator
    ) -> None:
        self._finger = palette.fingers[rng.integers(len(palette.fingers))]
        self._palm = palette.palms[rng.integers(len(palette.palms))]
        table = palette.tables[rng.integers(len(palette.tables))](rng)
        self._model = _model(appearance, lighting, table, rng)
        self._data: Any = mujoco.MjData(self._model)
        self.camera = SceneCamera(self._model, Optics())

    def arrange(self, position: Float64, rotation: Float64, rods: Sequence[Capsule]) -> None:
        """Put the die and all rods where they are."""
        self._data.mocap_pos[0], self._data.mocap_quat[0] = position, rotation
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self.camera.options.geomgroup[:] = 1
        self.camera.update(self._data)
        self._add(mujoco.mjtGeom.mjGEOM_BOX, _PALM_HALF_M, (0.0, 0.0, -PALM_BELOW_M), _NO_TURN, self._palm)
        for rod in rods:
            geom = self._add(mujoco.mjtGeom.mjGEOM_CAPSULE, (0, 0, 0), (0, 0, 0), _NO_TURN, self._finger)
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_connector(geom, kind, rod.radius, rod.start, rod.end)

    def die_alone(self, T_world_camera: Float64) -> NDArray[np.float32]:
        """Depth (H, W), m, of the die as last arranged, with nothing else there."""
        self.camera.options.geomgroup[:] = 0
        self.camera.options.geomgroup[_DIE_GROUP] = 1
        self.camera.update(self._data)
        return self.camera.depth(T_world_camera)

    def close(self) -> None:
        """Free the camera."""
        self.camera.close()

    def _add(self, kind: Any, size: Any, position: Any, matrix: Any, rgb: tuple[float, ...]) -> Any:
        scene = self.camera.scene
        geom = scene.geoms[scene.ngeom]
        rgba = np.array([*rgb, 1.0], np.float32)
        mujoco.mjv_initGeom(geom, kind, np.array(size, float), np.array(position, float), matrix, rgba)
        geom.segid = scene.ngeom  # else it is left out where only depth is drawn
        scene.ngeom += 1
        return geom


def _model(
    appearance: Appearance, lighting: Lighting, table: NDArray[np.uint8], rng: np.random.Generator
) -> Any:
    spec = mujoco.MjSpec()
    spec.visual.quality.shadowsize = 2048
    spec.visual.headlight.active = False
    spec.stat.extent, spec.stat.center = 0.5, (0.0, 0.0, 0.0)
    _add_lights(spec, lighting)
    _add_table(spec, table, float(rng.uniform(3.0, 5.0)))
    _add_die(spec, appearance, rng)
    return spec.compile()


def _add_lights(spec: Any, lighting: Lighting) -> None:
    lamps = (lighting.key, lighting.key_from, True), (lighting.fill, lighting.fill_from, False)
    for colour, origin, shadow in lamps:
        spec.worldbody.add_light(
            pos=origin,
            dir=-np.array(origin),
            diffuse=colour,
            specular=colour,
            ambient=(lighting.ambient / 2,) * 3,
            castshadow=shadow,
        )


def _add_table(spec: Any, picture: NDArray[np.uint8], repeat: float) -> None:
    _add_picture(spec, "table", picture)
    material = spec.add_material(name="table", specular=0.1, texrepeat=(repeat, repeat))
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "table"
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(1.5, 1.5, 0.1),
        pos=(0.0, 0.0, -TABLE_BELOW_M),
        material="table",
    )
    assert picture.shape == (TABLE_PIXELS, TABLE_PIXELS, 3)


def _add_die(spec: Any, appearance: Appearance, rng: np.random.Generator) -> None:
    mesh = appearance.die.mesh()
    _add_picture(spec, DIE, worn_atlas(appearance.die, appearance.wear, rng))
    spec.add_mesh(
        name=DIE,
        uservert=mesh.vertices.ravel(),
        userface=mesh.triangles.ravel(),
        usertexcoord=mesh.uv.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    material = spec.add_material(
        name=DIE,
        specular=appearance.specular,
        shininess=appearance.shininess,
        rgba=(1.0, 1.0, 1.0, appearance.opacity),
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = DIE
    body = spec.worldbody.add_body(name=DIE, mocap=True)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=DIE, material=DIE, group=_DIE_GROUP)


def _add_picture(spec: Any, name: str, picture: NDArray[np.uint8]) -> None:
    height, width = picture.shape[:2]
    texture = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
    )
    texture.data = picture.tobytes()

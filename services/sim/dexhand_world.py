"""What is around the DexHand 021: solver, light, table, and the die as a free body."""

from __future__ import annotations

from typing import Any

import mujoco as compiled_mujoco

from common.die import Die
from services.sim.dexhand_physics import TwinPhysics

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs

DIE = "die"
COLLISION_GROUP, SHOWN_GROUP = 3, 1

_TABLE = (0.55, 0.50, 0.44, 1.0)
_SKY, _HORIZON = (0.16, 0.19, 0.24), (0.42, 0.45, 0.50)
_TABLE_HALF_M = 1.0  # as drawn


def set_options(spec: Any, physics: TwinPhysics) -> None:
    """Angles in radians, a solver that lets a held thing rest, and pictures of up to 1280 x 960."""
    spec.compiler.degree = False
    spec.option.timestep = physics.timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0  # a held die must not creep
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 20.0
    spec.visual.quality.shadowsize = 2048
    spec.stat.extent, spec.stat.center = 0.3, (0.1, 0.0, 0.2)


def add_table(spec: Any) -> None:
    """The table, light, and a sky to see the hand against."""
    world = spec.worldbody
    world.add_light(pos=(0.2, -0.5, 1.0), dir=(-0.1, 0.45, -0.9), diffuse=(0.8, 0.8, 0.8))
    world.add_light(pos=(-0.5, 0.6, 0.8), dir=(0.5, -0.5, -0.7), diffuse=(0.35,) * 3, castshadow=False)
    world.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,  # without end: whatever falls stays on it
        size=(_TABLE_HALF_M, _TABLE_HALF_M, 0.1),
        rgba=_TABLE,
        condim=4,
    )
    spec.add_texture(
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_SKY,
        rgb2=_HORIZON,
        width=64,
        height=384,
    )


def add_die(spec: Any, die: Die) -> None:
    """A free cube that collides as a sharp-edged box and looks like a rounded die.

    A rounded collision mesh costs several times the contact work and its contact points jitter.
    """
    body = spec.worldbody.add_body(name=DIE)
    body.add_freejoint(name=DIE)
    body.explicitinertial = True
    body.mass, body.inertia = die.mass_kg, die.inertia
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(die.half_m,) * 3,
        friction=(0.3, 0.005, 0.0001),  # of two touching surfaces MuJoCo takes the rougher
        condim=4,
        group=COLLISION_GROUP,
    )
    _add_surface(spec, die)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=DIE,
        material=DIE,
        contype=0,
        conaffinity=0,
        mass=0.0,
        group=SHOWN_GROUP,
    )


def _add_surface(spec: Any, die: Die) -> None:
    mesh, atlas = die.mesh(), die.atlas()
    spec.add_mesh(
        name=DIE,
        uservert=mesh.vertices.ravel(),
        userface=mesh.triangles.ravel(),
        usertexcoord=mesh.uv.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    texture = spec.add_texture(
        name=DIE,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=atlas.shape[1],
        height=atlas.shape[0],
        nchannel=3,
    )
    texture.data = atlas.tobytes()
    material = spec.add_material(name=DIE, specular=0.3, shininess=0.3)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = DIE

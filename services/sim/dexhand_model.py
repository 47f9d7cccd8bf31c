"""The DexHand 021 with the die above a table, as a MuJoCo model made of primitive shapes.

World: metres, z up, the hand's wrist fixed. The hand, its links and sensors are named as in dexhand_links;
the left hand is the right one mirrored in the palm's y.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import NDArray

from common import geometry
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import JOINTS, Hand
from common.task.die import DieTask
from services.sim import dexhand_links as links
from services.sim.dexhand_links import Block, Capsule, Link, Vector
from services.sim.dexhand_physics import TwinPhysics
from services.sim.dexhand_world import COLLISION_GROUP, SHOWN_GROUP, add_die, add_table, set_options

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs
Floats = NDArray[np.float64]

PALM = "palm"

_SHELL = (0.30, 0.32, 0.36, 1.0)
_BONE = (0.52, 0.55, 0.60, 1.0)
_PAD = (0.93, 0.55, 0.25, 1.0)


def build_model(task: DieTask, assumed: DexHandConfig, physics: TwinPhysics) -> Any:
    """Compile the model of `assumed.hand` with the task's die; actuators are in the order of JOINTS."""
    spec = mujoco.MjSpec()
    set_options(spec, physics)
    add_table(spec)
    builder = _HandBuilder(spec, physics, mirrored=assumed.hand is Hand.LEFT)
    builder.add_palm(mount_of(task), physics.table_m)
    for link in links.LINKS:
        builder.add_link(link)
    builder.exclude_contacts()
    builder.add_motors()
    builder.couple(passive_ratios(assumed))
    add_die(spec, replace(task.die, mass_kg=physics.die_mass_kg))
    return spec.compile()


def mount_of(task: DieTask) -> Floats:
    """The palm's rotation (4,) in the world: `task.up` is the world's z, the fingers point along its x."""
    up = np.array(task.up) / np.linalg.norm(task.up)
    fingers = np.array([0.0, 0.0, 1.0]) - up[2] * up
    fingers /= np.linalg.norm(fingers)
    rotation = np.zeros(4)
    mujoco.mju_mat2Quat(rotation, np.stack([fingers, np.cross(up, fingers), up]).ravel())
    return rotation


def passive_ratios(assumed: DexHandConfig) -> dict[str, tuple[str, float]]:
    """For each joint without a motor, the motor's joint that it follows, and its angle per that one's."""
    index, ring, little = assumed.spread_ratios
    distal = {name: (f"{name[0]}_3", assumed.distal_ratio) for name in links.DISTAL_LINKS}
    return {**distal, "4_1": ("2_1", ring / index), "5_1": ("2_1", little / index)}


def quaternion_of(turn: Vector) -> Floats:
    """Unit quaternion (4,) of fixed-axis roll, pitch and yaw."""
    roll, pitch, yaw = (
        geometry.from_axis_angle(axis, np.array(angle)) for axis, angle in zip(np.eye(3), turn, strict=True)
    )
    return geometry.multiply(yaw, geometry.multiply(pitch, roll))


class _HandBuilder:
    """Adds the hand to a model, mirrored or not."""

    def __init__(self, spec: Any, physics: TwinPhysics, mirrored: bool) -> None:
        self._spec = spec
        self._physics = physics
        self._side = -1.0 if mirrored else 1.0
        self._bodies: dict[str, Any] = {}
        self._ranges: dict[str, float] = {
            name: joint.model_high_rad for name, joint in zip(links.MOTOR_JOINTS, JOINTS, strict=True)
        }

    def add_palm(self, rotation: Floats, height_m: float) -> None:
        """The fixed palm, its frame's origin `height_m` above the world's."""
        palm = self._spec.worldbody.add_body(name=PALM, pos=(0.0, 0.0, height_m), quat=rotation)
        self._bodies[PALM] = palm
        self._weigh(palm, links.PALM_MASS, links.PALM_COM, links.PALM_INERTIA)
        for block in links.PALM_BLOCKS:
            self._add_block(palm, block)

    def add_link(self, link: Link) -> None:
        """A link with its joint, shape, and, at a fingertip, its pad and force sensor."""
        quaternion = quaternion_of(link.turn) * (1.0, self._side, 1.0, self._side)
        body = self._bodies[link.parent].add_body(
            name=link.name, pos=self._mirror(link.position), quat=quaternion
        )
        self._bodies[link.name] = body
        self._weigh(body, link.mass, link.com, link.inertia)
        if not link.fixed:
            self._add_joint(body, link.name)
        if link.shape is not None:
            self._add_capsule(body, link.shape)
        if link.name in links.DISTAL_LINKS:
            self._add_pad(body, link)

    def exclude_contacts(self) -> None:
        """Neighbours along a finger never touch; MuJoCo assumes so only where neither is fixed."""
        neighbours = ((link.parent, link.name) for link in links.LINKS)
        for first, second in dict.fromkeys((*neighbours, *links.EXCLUDED)):
            self._spec.add_exclude(bodyname1=first, bodyname2=second)

    def add_motors(self) -> None:
        """A position loop with limited torque for each motor; its group is its number, to switch it off."""
        physics = self._physics
        for number, (name, joint) in enumerate(zip(links.MOTOR_JOINTS, JOINTS, strict=True)):
            actuator = self._spec.add_actuator(
                name=joint.name,
                target=name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                group=number,
                ctrlrange=(0.0, joint.model_high_rad),
                forcerange=(-physics.torque_nm, physics.torque_nm),
            )
            actuator.set_to_position(kp=physics.stiffness_nm_rad, kv=physics.damping_nms_rad)
            self._limit(name, joint.model_high_rad)

    def couple(self, ratios: dict[str, tuple[str, float]]) -> None:
        """Let each passive joint follow its motor's."""
        for name, (leader, ratio) in ratios.items():
            self._spec.add_equality(
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=name,
                name2=leader,
                data=[0.0, ratio, 0.0, 0.0, 0.0, *[0.0] * 6],
                solref=(0.01, 1.0),
            )
            self._limit(name, ratio * self._ranges[leader])

    def _add_joint(self, body: Any, name: str) -> None:
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=(0.0, 0.0, self._side),  # a mirror turns a rotation about z into one about -z
            damping=[self._physics.friction_nms_rad, 0, 0],
            armature=self._physics.armature_kgm2,
        )

    def _limit(self, name: str, high_rad: float) -> None:
        joint = self._spec.joint(name)
        joint.range, joint.limited = (0.0, high_rad), True

    def _weigh(self, body: Any, mass: float, com: Vector, inertia: Vector) -> None:
        body.explicitinertial = True
        body.mass, body.ipos, body.inertia = mass, self._mirror(com), inertia

    def _add_capsule(self, body: Any, shape: Capsule) -> None:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*self._mirror(shape.start), *self._mirror(shape.end)],
            size=(shape.radius, 0, 0),
            friction=(self._physics.finger_friction, 0.005, 0.0001),
            condim=4,
            group=SHOWN_GROUP,
            rgba=_BONE,
        )

    def _add_block(self, body: Any, block: Block) -> None:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=self._mirror(block.centre),
            size=block.half,
            friction=(self._physics.palm_friction, 0.005, 0.0001),
            condim=4,
            group=SHOWN_GROUP,
            rgba=_SHELL,
        )

    def _add_pad(self, body: Any, link: Link) -> None:
        """The sensitive pad: what presses on the front of the fingertip counts, along its normal."""
        along, out, _ = links.PAD
        height = link.shape.start[2] if link.shape else 0.0
        turn = quaternion_of((0.0, 0.0, self._side * links.PAD_TURN))
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            pos=self._mirror((along, out, height)),
            quat=turn,
            size=(0.010, 0.0012, 0.006),
            contype=0,
            conaffinity=0,
            group=SHOWN_GROUP,
            rgba=_PAD,
        )
        self._add_touch(body, f"pad_{link.name[0]}", (along, out - 0.004, height), turn)

    def _add_touch(self, body: Any, name: str, centre: Vector, turn: Floats) -> None:
        """A force sensor, so thick that all contacts of the tip's front are in it; the maker's is 1 mm."""
        body.add_site(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=self._mirror(centre),
            quat=turn,
            size=(0.014, 0.008, 0.011),
            group=COLLISION_GROUP,
        )
        self._spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_TOUCH,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=name,
        )

    def _mirror(self, point: Vector) -> Vector:
        return point[0], self._side * point[1], point[2]

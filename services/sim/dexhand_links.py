"""The DexHand 021's links as data: where each joint sits, what each link weighs, how it is shaped.

Dimensions from DexRobot dexrobot_urdf and dexrobot_mujoco (Apache-2.0), simplified right hand. Metres,
radians, kilograms; each frame is its parent's, turned by fixed-axis roll, pitch, yaw; each joint turns about
its own +z. The palm's frame: +z to the fingertips, +x out of the palm, +y to the thumb. A left hand is the
mirror image in y. Masses are the maker's estimates, not measured.
"""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]

_QUARTER = 1.5708  # as the maker rounds it
NO_TURN: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Capsule:
    """A rod between two points of the link's frame, with round ends."""

    start: Vector
    end: Vector
    radius: float


@dataclass(frozen=True)
class Link:
    """One moving part; `inertia` is diagonal, about `com`. Index 1 to 5 is thumb, index, ..., little."""

    name: str
    parent: str
    position: Vector
    turn: Vector
    mass: float
    com: Vector
    inertia: Vector
    shape: Capsule | None = None
    fixed: bool = False


@dataclass(frozen=True)
class Block:
    """A part of the palm: centre and half sizes in the palm's frame."""

    centre: Vector
    half: Vector


PALM_MASS = 0.8835
PALM_COM: Vector = (-0.0016, 0.0010, 0.0940)
PALM_INERTIA: Vector = (2.30e-3, 1.76e-3, 1.01e-3)
# The maker's collision box, and the narrower part towards the wrist that its mesh has.
PALM_BLOCKS = (
    Block((-0.0022, 0.0, 0.11), (0.0273, 0.05, 0.05)),
    Block((-0.0022, 0.0, 0.03), (0.0240, 0.034, 0.03)),
)

# In a distal link's frame: the fingertip, the middle of its sensitive pad, and the pad's tilt about z.
TIP: Vector = (0.035, -0.004, 0.0)
PAD: Vector = (0.026, 0.0025, 0.0)
PAD_TURN = -0.45

_KNUCKLE_INERTIA: Vector = (2.8e-7, 4.3e-7, 4.3e-7)  # of a solid block of the mesh's size: none is published
_PROXIMAL_INERTIA: Vector = (5.5e-7, 1.66e-6, 1.64e-6)
_MIDDLE_INERTIA: Vector = (2.0e-7, 3.6e-7, 3.8e-7)
_DISTAL_INERTIA: Vector = (3.2e-7, 7.4e-7, 7.4e-7)
_DISTAL_MASS = 0.0062 + 0.001 + 0.001  # with the tip's and the pad's own bodies


def _outer(finger: int, pad_z: float = 0.0) -> tuple[Link, Link]:
    """Middle and distal link, the same for all fingers but for the height of the thumb's pad."""
    middle, distal = f"{finger}_3", f"{finger}_4"
    slim = Capsule((0.002, 0.0, 0.0), (0.023, 0.0, 0.0), 0.0085)
    tip = Capsule((0.0, 0.0, pad_z), (0.026, -0.007, pad_z), 0.0095)
    at = (0.043, 0.0, 0.0), (0.025, 0.0, 0.0)
    return (
        Link(middle, f"{finger}_2", at[0], NO_TURN, 0.0046, (0.0135, -0.0007, 0.0), _MIDDLE_INERTIA, slim),
        Link(distal, middle, at[1], NO_TURN, _DISTAL_MASS, (0.0163, -0.0037, 0.0), _DISTAL_INERTIA, tip),
    )


def _thumb() -> tuple[Link, ...]:
    at, turn = (0.032783, 0.023781, 0.11211), (-2.8732, -0.15197, 1.3168)
    rod = Capsule((0.0, 0.0, 0.0), (0.03, 0.0, -0.002), 0.0095)
    com = (0.0020, -0.0004, 0.0135), (0.0212, -0.0006, 0.0)
    base = Link("1_1", "palm", at, turn, 0.0044, com[0], _KNUCKLE_INERTIA)
    at, turn = (0.0083307, 0.0, 0.0), (-_QUARTER, 0.0, 0.0)
    return base, Link("1_2", "1_1", at, turn, 0.0100, com[1], _PROXIMAL_INERTIA, rod), *_outer(1, -0.001)


def _finger(finger: int, y: float, z: float, over: bool, fixed: bool = False) -> tuple[Link, ...]:
    """A finger whose spread axis is at (y, z); `over`: it spreads away from the thumb."""
    roll = 3.1416 if over else 0.0
    at, turn = (0.006966, y, z), (roll, -_QUARTER, 0.0)
    bone = Capsule((0.005, 0.0, 0.0), (0.038, 0.0, 0.0), 0.0095)
    block = Capsule((0.004, 0.0, 0.0), (0.013, 0.0, 0.0), 0.0085)
    first, second = f"{finger}_1", f"{finger}_2"
    com = (0.0070, 0.0, 0.0010), (0.0212, -0.0006, 0.0)
    knuckle = Link(first, "palm", at, turn, 0.0041, com[0], _KNUCKLE_INERTIA, block, fixed)
    at, turn = (0.017, 0.0, 0.0), (_QUARTER if over else -_QUARTER, 0.0, 0.0)
    proximal = Link(second, first, at, turn, 0.0094, com[1], _PROXIMAL_INERTIA, bone)
    return knuckle, proximal, *_outer(finger)


LINKS: tuple[Link, ...] = (
    *_thumb(),
    *_finger(2, 0.034912, 0.1644, over=False),
    *_finger(3, 0.010612, 0.1734, over=False, fixed=True),
    *_finger(4, -0.013688, 0.1644, over=True),
    *_finger(5, -0.037988, 0.1504, over=True),
)
DISTAL_LINKS = tuple(link.name for link in LINKS if link.name.endswith("_4"))

# Pairs that touch by construction, beyond each link and its parent.
EXCLUDED = (("palm", "1_2"), *((f"{finger}_1", "palm") for finger in range(1, 6)))

# The joint that each motor turns, in the order of common.dexhand021.tables.JOINTS.
MOTOR_JOINTS = ("1_3", "1_2", "1_1", "2_1", "2_3", "2_2", "3_3", "3_2", "4_3", "4_2", "5_3", "5_2")
# Joints without a motor: all the distal ones, ring and little finger's spread.
PASSIVE_JOINTS = (*DISTAL_LINKS, "4_1", "5_1")

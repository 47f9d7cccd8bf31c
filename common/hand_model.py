"""What a dexterous hand is made of, as data: links, joints, capsules, and how its joints follow a command."""

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

NO_TURN: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Link:
    """A part that moves by one joint: where its frame sits in its parent's (m, wxyz), then the joint's axis.

    The frame turns about `axis`, a unit vector in it, by the angle of `joint`.
    """

    name: str
    parent: str
    position: Vector
    joint: str
    axis: Vector
    turn: Quaternion = NO_TURN


@dataclass(frozen=True)
class Capsule:
    """A rod with round ends between two points of a link's frame, m."""

    link: str
    start: Vector
    end: Vector
    radius: float


@dataclass(frozen=True)
class Plane:
    """The side of a link that objects lie on: a point of it, m, and its outward unit normal, link's frame."""

    link: str
    point: Vector
    normal: Vector


@dataclass(frozen=True)
class Servo:
    """How a joint moves within one control step, untouched: q' - q = `pull`·(target - q) + `carry_s`·q̇.

    Actions -1 and 1 command the targets `low` and `high`, rad; a joint without actuator is not pulled.
    """

    joint: str
    pull: float
    carry_s: float
    low: float = 0.0
    high: float = 0.0


@dataclass(frozen=True)
class HandModel:
    """A hand whose first links hang on the world; parents stand before their children."""

    links: tuple[Link, ...]
    capsules: tuple[Capsule, ...]
    palm: Plane
    servos: tuple[Servo, ...]

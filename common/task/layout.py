"""How a state vector is laid out: named groups with unit and plausible range, and the Shadow Hand's names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

FINGER_NAMES = ("ff", "mf", "rf", "lf", "th")

JOINT_NAMES = (
    *("WRJ1", "WRJ0"),
    *("FFJ3", "FFJ2", "FFJ1", "FFJ0"),
    *("MFJ3", "MFJ2", "MFJ1", "MFJ0"),
    *("RFJ3", "RFJ2", "RFJ1", "RFJ0"),
    *("LFJ4", "LFJ3", "LFJ2", "LFJ1", "LFJ0"),
    *("THJ4", "THJ3", "THJ2", "THJ1", "THJ0"),
)

# A tendon couples each finger's last joint to the one before; only the thumb's is driven.
ACTUATOR_NAMES = tuple(name for name in JOINT_NAMES if name not in ("FFJ0", "MFJ0", "RFJ0", "LFJ0"))


@dataclass(frozen=True)
class Group:
    """Consecutive state dimensions [start, stop) of one kind; a value outside [low, high] has diverged.

    A quaternion group's `low` and `high` bound its norm, since a prediction may leave the unit sphere.
    """

    name: str
    start: int
    stop: int
    unit: str
    low: float
    high: float
    kind: Literal["vector", "quaternion"] = "vector"

    @property
    def slice(self) -> slice:
        """Index of this group in the last axis of a state."""
        return slice(self.start, self.stop)


# Random actions reach 1.4 rad and 14 rad/s at the joints and 6 rad/s at the object; a dropped object falls
# to the floor: the bounds leave room for whatever a plant does and exclude only what a diverging model does.
HAND_GROUPS = (
    Group("qpos", 0, 24, "rad", -2.5, 2.5),
    Group("qvel", 24, 48, "rad/s", -100.0, 100.0),
)

REACH_GROUPS = (*HAND_GROUPS, Group("tips", 48, 63, "m", -0.5, 2.0))

OBJECT_GROUPS = (
    *HAND_GROUPS,
    Group("object_linear_velocity", 48, 51, "m/s", -20.0, 20.0),
    Group("object_angular_velocity", 51, 54, "rad/s", -200.0, 200.0),
    Group("object_position", 54, 57, "m", -5.0, 5.0),
    Group("object_rotation", 57, 61, "1", 0.5, 1.5, "quaternion"),
)

"""Which coordinates a task's networks use."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from common.model.config import CoordinatesName
from common.model.contact import ContactFeatures
from common.model.coordinates import Coordinates, ObjectCoordinates, RawCoordinates
from common.model.shapes import Cube, Ellipsoid, Shape
from common.shadow_hand import SHADOW_HAND
from common.task.layout import JOINT_NAMES, Group

# Gymnasium-Robotics 1.4.2, assets/hand/manipulate_egg.xml and manipulate_block.xml.
_EGG = Ellipsoid((0.03, 0.03, 0.04))
SHAPES: Mapping[str, Shape] = MappingProxyType({"egg": _EGG, "egg_rotate": _EGG, "block": Cube(0.025)})
_STEP_S = 0.04  # of the simulated Shadow Hand's control, whatever the cell's rate


class StateLayout(Protocol):
    """What a model needs to know of a task."""

    @property
    def name(self) -> str: ...
    @property
    def groups(self) -> tuple[Group, ...]: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def action_dim(self) -> int: ...


def coordinates_of(name: CoordinatesName, layout: StateLayout) -> Coordinates:
    """The coordinates called `name` for a task. Raises ValueError for a task that lacks an object of ours."""
    if name == "raw":
        quaternions = tuple(group.slice for group in layout.groups if group.kind == "quaternion")
        return RawCoordinates(layout.state_dim, layout.action_dim, quaternions)
    if layout.name not in SHAPES:
        raise ValueError(f"model.coordinates {name}: {layout.name} has none of {', '.join(SHAPES)}; use raw")
    shape = SHAPES[layout.name]
    contact = ContactFeatures(SHADOW_HAND, shape, JOINT_NAMES, _STEP_S) if name == "contact" else None
    return ObjectCoordinates(layout.action_dim, shape, contact)

"""Forward kinematics of a hand for many postures at once: a few wide operations for each level of the tree.

Postures lie along the last axis, so that every operation runs over them contiguously.
Letters: J joints, L links, C capsules, N postures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import torch
from torch import Tensor

from common.hand_model import HandModel, Link


class Frames(NamedTuple):
    """Where links are in the world: rotations (3, 3, L, N), columns are axes, and origins (3, L, N), m."""

    rotation: Tensor
    origin: Tensor

    def of(self, links: Tensor) -> Frames:
        """The frames of some links."""
        return Frames(self.rotation[:, :, links], self.origin[:, links])

    def states(self, part: slice) -> Frames:
        """The frames in some of the N postures."""
        return Frames(self.rotation[..., part], self.origin[..., part])

    def place(self, points: Tensor) -> Tensor:
        """Points (3, L, 1) of the links' own frames in the world: (3, L, N)."""
        return self.origin + (self.rotation * points).sum(1)


@dataclass(frozen=True)
class _Level:
    """Links whose parents are all one level above.

    The rotation within the parent's frame is `still` + sin θ·`sine` + (1 - cos θ)·`versine` (Rodrigues).
    """

    joints: Tensor  # (k,) index of each link's joint in the posture
    parents: Tensor | None  # (k,) index in the level above; None: each one's own
    offset: Tensor  # (3, k, 1) of the frame in its parent's, m
    still: Tensor  # (3, 3, k, 1)
    sine: Tensor
    versine: Tensor

    def to(self, device: torch.device | str) -> _Level:
        """The same on `device`."""
        names = [each.name for each in fields(self) if getattr(self, each.name) is not None]
        return replace(self, **{name: getattr(self, name).to(device) for name in names})


class Kinematics:
    """The tree of a hand's links. `joint_names` gives the order of the angles in a posture."""

    def __init__(self, hand: HandModel, joint_names: tuple[str, ...]) -> None:
        levels = _levels(hand)
        self._levels = [
            _level(links, above, joint_names) for above, links in zip([[], *levels[:-1]], levels, strict=True)
        ]
        order = [link.name for links in levels for link in links]
        self.index = {name: i for i, name in enumerate(order)}

    def to(self, device: torch.device | str) -> Kinematics:
        """The same tree on `device`."""
        moved = object.__new__(Kinematics)
        moved.index = self.index
        moved._levels = [level.to(device) for level in self._levels]
        return moved

    def frames(self, posture: Tensor) -> Frames:
        """Frames of all links, in the order of `index`, for joint angles (J, N), rad; differentiable."""
        sine, versine = posture.sin(), 1 - posture.cos()
        above: Frames | None = None
        found: list[Frames] = []
        for level in self._levels:
            turn = level.still + level.sine * sine[level.joints] + level.versine * versine[level.joints]
            if above is None:
                above = Frames(turn, level.offset.expand(-1, -1, posture.shape[1]))
            else:
                parent = above if level.parents is None else above.of(level.parents)
                rotation = (parent.rotation[:, :, None] * turn).sum(1)
                above = Frames(rotation, parent.place(level.offset))
            found.append(above)
        rotations, origins = zip(*found, strict=True)
        return Frames(torch.cat(rotations, dim=2), torch.cat(origins, dim=1))


def columns(vectors: list[tuple[float, ...]]) -> Tensor:
    """k vectors of length n → (n, k, 1)."""
    return torch.tensor(vectors, dtype=torch.float32).T[:, :, None].contiguous()


def _levels(hand: HandModel) -> list[list[Link]]:
    depth: dict[str, int] = {}
    levels: list[list[Link]] = []
    for link in hand.links:
        depth[link.name] = depth.get(link.parent, -1) + 1
        if depth[link.name] == len(levels):
            levels.append([])
        levels[depth[link.name]].append(link)
    return levels


def _level(links: list[Link], above: list[Link], joint_names: tuple[str, ...]) -> _Level:
    names = [link.name for link in above]
    parents = [names.index(link.parent) if names else 0 for link in links]
    cross = torch.stack([_cross(link.axis) for link in links])
    base = torch.stack([_matrix(link.turn) for link in links])
    parts = (base, base @ cross, base @ cross @ cross)
    still, sine, versine = (part.permute(1, 2, 0)[..., None].float().contiguous() for part in parts)
    return _Level(
        joints=torch.tensor([joint_names.index(link.joint) for link in links]),
        parents=None if parents == list(range(len(names))) else torch.tensor(parents),
        offset=columns([link.position for link in links]),
        still=still,
        sine=sine,
        versine=versine,
    )


def _cross(axis: tuple[float, ...]) -> Tensor:
    """The matrix (3, 3) of v → axis × v."""
    x, y, z = axis
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)


def _matrix(quaternion: tuple[float, ...]) -> Tensor:
    """Rotation matrix (3, 3) of a quaternion wxyz of any length but 0."""
    length = math.hypot(*quaternion)
    w, x, y, z = (part / length for part in quaternion)
    cross = _cross((x, y, z))
    return torch.eye(3, dtype=torch.float64) + 2 * w * cross + 2 * cross @ cross

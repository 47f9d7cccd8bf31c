"""How networks see a state and say its change: raw numbers, or an object's motion in the world's frame.

Letters: S state, A action, I inputs of a network, D numbers of a change, N states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from common import geometry
from common.model.contact import ContactFeatures, Thing
from common.model.shapes import Shape
from common.task.layout import OBJECT_GROUPS, Group


class Coordinates(Protocol):
    """Between states (.., S) and what networks take and give; all functions are differentiable."""

    @property
    def inputs(self) -> int:
        """I."""
        ...

    @property
    def changes(self) -> int:
        """D."""
        ...

    def part(self, group: Group) -> slice:
        """Where the change of one of the task's groups stands in (.., D)."""
        ...

    def encode(self, state: Tensor, action: Tensor) -> Tensor:
        """State (.., S) and action (.., A) → features (.., I), not standardised."""
        ...

    def change(self, state: Tensor, next_state: Tensor) -> Tensor:
        """What leads from `state` to `next_state`, (.., S) each: (.., D)."""
        ...

    def moved(self, state: Tensor, change: Tensor) -> Tensor:
        """The state (.., S) that `change` (.., D) leads to from `state` (.., S)."""
        ...

    def to(self, device: torch.device | str) -> Coordinates:
        """The same on `device`."""
        ...


@dataclass(frozen=True)
class RawCoordinates:
    """State and action as they are; a change is a difference, after which quaternions get norm 1 again."""

    state_dim: int
    action_dim: int
    quaternions: tuple[slice, ...] = ()

    @property
    def inputs(self) -> int:
        """I = S + A."""
        return self.state_dim + self.action_dim

    @property
    def changes(self) -> int:
        """D = S."""
        return self.state_dim

    def part(self, group: Group) -> slice:
        """The group's own place."""
        return group.slice

    def encode(self, state: Tensor, action: Tensor) -> Tensor:
        """State and action side by side."""
        return torch.cat((state, action), dim=-1)

    def change(self, state: Tensor, next_state: Tensor) -> Tensor:
        """The difference; each quaternion of `next_state` is read as the one of q and -q that is nearer."""
        for part in self.quaternions:
            q = next_state[..., part]
            away = (state[..., part] * q).sum(dim=-1, keepdim=True) < 0
            next_state = _replace(next_state, part, torch.where(away, -q, q))
        return next_state - state

    def moved(self, state: Tensor, change: Tensor) -> Tensor:
        """The sum; a quaternion near 0 stays short, never NaN."""
        state = state + change
        for part in self.quaternions:
            state = _replace(state, part, geometry.normalise(state[..., part]))
        return state

    def to(self, device: torch.device | str) -> RawCoordinates:
        """The same: nothing is held on a device."""
        return self


_SPIN, _QUATERNION = OBJECT_GROUPS[3].slice, OBJECT_GROUPS[5].slice


class ObjectCoordinates:
    """For `OBJECT_GROUPS`, hand and object: spin in the world's frame, and turns as world rotation vectors.

    Of the object's orientation networks see only what its shape shows, so that one experience teaches all
    orientations that look alike; the state keeps the full one. With `contact` they see where the hand
    touches.
    # Paper: networks take and give the state as it is. MuJoCo gives spin in the object's frame and rotation
    # as a quaternion, and the same touch then looks different in each orientation.
    """

    changes = 60

    def __init__(self, action_dim: int, shape: Shape, contact: ContactFeatures | None = None) -> None:
        self._shape, self._contact, self._action_dim = shape, contact, action_dim
        still = shape.orientation(torch.eye(3)[..., None])
        self.inputs = 57 + len(still) + action_dim + (contact.count if contact else 0)

    def part(self, group: Group) -> slice:
        """The group's own place, but for a rotation of three numbers."""
        return group.slice if group.kind == "vector" else slice(57, 60)

    def to(self, device: torch.device | str) -> ObjectCoordinates:
        """The same on `device`."""
        contact = None if self._contact is None else self._contact.to(device)
        return ObjectCoordinates(self._action_dim, self._shape, contact)

    def encode(self, state: Tensor, action: Tensor) -> Tensor:
        """Runs along the last axis inside, where a feature's N values are contiguous."""
        rows, actions = (x.reshape(-1, x.shape[-1]).T.contiguous() for x in (state, action))
        thing = _thing(rows)
        orientation = self._shape.orientation(thing.rotation)
        found = [rows[: _SPIN.start], thing.spin, thing.position, orientation, actions]
        if self._contact is not None:
            found.append(self._contact(rows[:24], rows[24:48], actions, thing))
        return torch.cat(found).T.reshape(*state.shape[:-1], -1)

    def change(self, state: Tensor, next_state: Tensor) -> Tensor:
        """Differences; of the spin in the world's frame, and the turn as a world rotation vector, rad."""
        before, after = (geometry.normalise(s[..., _QUATERNION]) for s in (state, next_state))
        turn = geometry.to_rotation_vector(geometry.multiply(after, geometry.conjugate(before)))
        spins = [geometry.rotate(q, s[..., _SPIN]) for q, s in ((before, state), (after, next_state))]
        difference = next_state - state
        start, stop = _SPIN.start, _SPIN.stop
        parts = (difference[..., :start], spins[1] - spins[0], difference[..., stop : stop + 3], turn)
        return torch.cat(parts, dim=-1)

    def moved(self, state: Tensor, change: Tensor) -> Tensor:
        """Inverse of `change`."""
        before = geometry.normalise(state[..., _QUATERNION])
        after = geometry.multiply(geometry.from_rotation_vector(change[..., -3:]), before)
        start, stop = _SPIN.start, _SPIN.stop
        spin = geometry.rotate(before, state[..., start:stop]) + change[..., start:stop]
        plain = (state[..., :start] + change[..., :start], state[..., stop : stop + 3] + change[..., stop:-3])
        return torch.cat((plain[0], geometry.rotate(geometry.conjugate(after), spin), plain[1], after), -1)


def _thing(rows: Tensor) -> Thing:
    """The object of states (S, N), its spin turned into the world's frame."""
    w, x, y, z = geometry.normalise(rows[57:61].T).T
    entries = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    rotation = torch.stack([torch.stack(row) for row in entries])
    spin = (rotation * rows[51:54]).sum(1)
    return Thing(rotation, position=rows[54:57], velocity=rows[48:51], spin=spin)


def _replace(state: Tensor, part: slice, value: Tensor) -> Tensor:
    return torch.cat((state[..., : part.start], value, state[..., part.stop :]), dim=-1)

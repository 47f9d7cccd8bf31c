"""Where a hand touches an object, and how it is about to: fixed features of state and action.

What a network would otherwise have to learn of the hand's kinematics and the object's shape.
Letters: J joints, C capsules, N states.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import torch
from torch import Tensor

from common.hand_model import HandModel
from common.model.kinematics import Frames, Kinematics, columns
from common.model.shapes import Shape

_NEAR_M = 0.006  # a gap at which a finger's influence has fallen to 1/e
_BISECTIONS = 4  # to 1/32 of a rod, 1.4 mm, which changes the gap by 0.03 mm
_FAR_M = 0.1  # gaps are told up to here: beyond it nothing touches within a plan


class Thing(NamedTuple):
    """An object: rotation (3, 3, N), position (3, N), m, velocities (3, N), m/s and rad/s, world frame."""

    rotation: Tensor
    position: Tensor
    velocity: Tensor
    spin: Tensor


class ContactFeatures:
    """Gaps, lever arms and coming motion of each finger capsule and the palm, relative to an object."""

    def __init__(self, hand: HandModel, shape: Shape, joint_names: tuple[str, ...], step_s: float) -> None:
        self._shape, self._step_s = shape, step_s
        self._kinematics = Kinematics(hand, joint_names)
        link = self._kinematics.index
        self._links = torch.tensor([link[capsule.link] for capsule in hand.capsules])
        self._start = columns([capsule.start for capsule in hand.capsules])
        self._rod = columns([capsule.end for capsule in hand.capsules]) - self._start
        self._radius = torch.tensor([capsule.radius for capsule in hand.capsules])[:, None]
        self._palm = torch.tensor([link[hand.palm.link]])
        self._palm_point = columns([hand.palm.point])
        self._palm_normal = columns([hand.palm.normal])
        servo = {each.joint: each for each in hand.servos}
        servos = [servo[name] for name in joint_names]
        self._pull = torch.tensor([each.pull for each in servos])[:, None]
        self._carry = torch.tensor([each.carry_s for each in servos])[:, None]
        driven = [each for each in servos if each.high > each.low]
        self._driven = torch.tensor([joint_names.index(each.joint) for each in driven])
        self._middle = torch.tensor([(each.high + each.low) / 2 for each in driven])[:, None]
        self._half = torch.tensor([(each.high - each.low) / 2 for each in driven])[:, None]

    def to(self, device: torch.device | str) -> ContactFeatures:
        """The same on `device`."""
        moved = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, (Tensor, Kinematics)):
                setattr(moved, name, value.to(device))
        return moved

    @property
    def count(self) -> int:
        """Features a state has."""
        return 12 * len(self._links) + 6 + 4

    def __call__(self, posture: Tensor, rates: Tensor, action: Tensor, thing: Thing) -> Tensor:
        """Joint angles (J, N), rad, their rates (J, N), rad/s, and action (A, N) → features (count, N)."""
        N = posture.shape[1]
        coming = self._coming(posture, rates, action)
        frames = self._kinematics.frames(torch.cat((posture, coming), dim=1))
        rods = frames.of(self._links)
        now = Frames(rods.rotation[..., :N], rods.origin[..., :N])
        later = Frames(rods.rotation[..., N:], rods.origin[..., N:])
        nearest, gap, normal, inner = self._touch(now, thing)
        moved = later.place(inner) - now.place(inner)
        arm = nearest - thing.position[:, None]
        carried = (thing.velocity[:, None] + _cross(thing.spin[:, None], arm)) * self._step_s
        closing = moved - carried
        near = torch.exp(-gap.clamp(min=0.0) / _NEAR_M)
        next_gap = gap + (normal * closing).sum(0)
        push = near * moved
        vectors = [part.flatten(0, 1) for part in (arm, normal, closing)]
        sums = (push.sum(1), _cross(arm, push).sum(1))
        return torch.cat((*vectors, gap, near, next_gap, *sums, self._palm_features(frames, thing)))

    def _coming(self, posture: Tensor, rates: Tensor, action: Tensor) -> Tensor:
        """Where the joints would be after the step if nothing were in their way, rad (J, N)."""
        target = posture.index_copy(0, self._driven, self._middle + self._half * action)
        return posture + self._pull * (target - posture) + self._carry * rates

    def _touch(self, rods: Frames, thing: Thing) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The point of each rod nearest the object, its gap and normal, and the point in the link's frame."""
        start = _seen(thing, rods.place(self._start) - thing.position[:, None])
        rod = _seen(thing, (rods.rotation * self._rod).sum(1))
        share = self._nearest(start, rod)
        gap, normal = self._shape.gap(start + share * rod)
        inner = self._start + share * self._rod
        outward = (thing.rotation[:, :, None] * normal).sum(1)
        return rods.place(inner), (gap - self._radius).clamp(max=_FAR_M), outward, inner

    @torch.no_grad()
    def _nearest(self, start: Tensor, rod: Tensor) -> Tensor:
        """Where along each rod (3, C, N) its gap is smallest (C, N), by bisection: the gap is convex there.

        Held constant for gradients, which is exact for the gap: at its minimum it does not change along the
        rod.
        """
        share, step = torch.full_like(start[0], 0.5), 0.25
        for _ in range(_BISECTIONS):
            _, normal = self._shape.gap(start + share * rod)
            share = share - step * (normal * rod).sum(0).sign()
            step /= 2
        share[share < 2 * step] = 0.0
        share[share > 1 - 2 * step] = 1.0
        return share

    def _palm_features(self, frames: Frames, thing: Thing) -> Tensor:
        """The object's place in the palm's frame, m, and the gap to the palm (4, N)."""
        N = thing.position.shape[1]
        rotation, origin = frames.rotation[:, :, self._palm, :N], frames.origin[:, self._palm, :N]
        palm = Frames(rotation, origin)
        normal = (palm.rotation * self._palm_normal).sum(1)[:, 0]
        height = (normal * (thing.position - palm.place(self._palm_point)[:, 0])).sum(0)
        facing = _seen(thing, normal[:, None])[:, 0]
        place = (palm.rotation * (thing.position[:, None] - palm.origin)[:, None]).sum(0)[:, 0]
        return torch.cat((place, (height - self._shape.extent(facing))[None]))


def _seen(thing: Thing, vectors: Tensor) -> Tensor:
    """World vectors (3, C, N) in the object's own frame."""
    return (thing.rotation[:, :, None] * vectors[:, None]).sum(0)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """Vector products of (3, C, N), which are written out: three wide operations, not a strided one."""
    (ax, ay, az), (bx, by, bz) = a.unbind(), b.unbind()
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))

"""Finds the die in one frame without a prior: planes give its axes, pips which face is which and where.

Slow (tens of ms): it runs in a worker while tracking goes on elsewhere, on a copy of the colours.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.die import CUBE_ROTATIONS
from services.perception.cpu.face_match import Match, match_face
from services.perception.cpu.fit import Fit, Fitter
from services.perception.cpu.labels import LABELS, bayes, relabelled
from services.perception.cpu.normals import cube_axes, oriented_points, planes_along, spread_rotations
from services.perception.cpu.pose import Float64, Pose, angle_rad
from services.perception.cpu.seeds import find_seeds
from services.perception.cpu.view import View, colours_around, look_up
from services.perception.frames import Frame

_RADIUS_M = 0.075
_STARTS = spread_rotations(24)


class Found(NamedTuple):
    """A pose that fits a frame, and the posterior (24,) of its labellings from that frame alone."""

    fit: Fit
    posterior: Float64


class Before(NamedTuple):
    """Where the die was last seen, and by how much it may have turned since: one deviation, rad."""

    pose: Pose
    turned_rad: float


def register(
    frame: Frame,
    fitter: Fitter,
    before: Before | None = None,
    mask: NDArray[np.bool_] | None = None,
    most: int = 6,
) -> Found | None:
    """The best pose in a frame, or None; looks where the die was first, then where `mask` (H, W) allows."""
    size = 2 * fitter.surface.half
    seeds = find_seeds(frame, fitter.colours.odds, size, 5, mask)
    if before is not None:
        seeds = np.concatenate([before.pose.translation[None], seeds])
    best: Found | None = None
    for seed in seeds:
        found = _register_at(frame, fitter, seed, before, most)
        if found is not None and (best is None or found.fit.score > best.fit.score):
            best = found
        if best is not None and best.fit.score > 1.6 and not best.fit.poor:
            break
    return best


def _register_at(
    frame: Frame, fitter: Fitter, seed: Float64, before: Before | None, most: int
) -> Found | None:
    about = Pose(np.eye(3), seed)
    view = fitter.view(frame, about, extra_px=60)
    if view is None:
        return None
    surroundings = colours_around(view, seed, _RADIUS_M)
    fitter = replace(fitter, colours=fitter.colours.learned(surroundings[:0], surroundings))
    view = view._replace(odds=look_up(fitter.colours.odds, view.colour))
    best: Fit | None = None
    for start in _hypotheses(fitter, view, seed)[:most]:
        fit = fitter.fit(start, None, view)
        if best is None or fit.score > best.score:
            best = fit
    if best is None or best.misplaced:
        return None
    best = fitter.fit(best.pose, None, view, alone=True)
    return None if best.strayed else _labelled(best, before)


def _labelled(fit: Fit, before: Before | None) -> Found:
    """Turned to the likeliest labelling, given the pips and how far the die may have turned."""
    posterior = bayes(_label_prior(fit.pose, before), fit.likelihood, 0.0)
    label = int(np.argmax(posterior))
    turned = Pose(fit.pose.rotation @ CUBE_ROTATIONS[label], fit.pose.translation)
    return Found(fit._replace(pose=turned), relabelled(posterior, label))


def _label_prior(pose: Pose, before: Before | None) -> Float64:
    """Chances (24,) of the labellings of a pose, by how far the die would have turned."""
    if before is None:
        return np.full(LABELS, 1.0 / LABELS)
    turns = np.array([angle_rad(pose.rotation @ c, before.pose.rotation) for c in CUBE_ROTATIONS])
    chances = np.exp(-0.5 * (turns / before.turned_rad) ** 2) + 1e-6
    return chances / chances.sum()


def _hypotheses(fitter: Fitter, view: View, seed: Float64) -> list[Pose]:
    """Poses worth refining, the most likely first."""
    surface = fitter.surface
    cloud = oriented_points(view, seed, _RADIUS_M)
    if len(cloud.points) < 40:
        return []
    rotation, _ = cube_axes(cloud.normals, _STARTS)
    least = max(20, len(cloud.points) // 20)
    matches: list[Match] = []
    for face, normal in enumerate(surface.normals @ rotation.T):
        for offset in planes_along(normal, cloud, least):
            own = np.abs(cloud.points @ normal - offset) < 0.006
            own &= cloud.normals @ normal > 0.9
            if own.sum() < least:
                continue
            points = cloud.points[own]
            middle = 0.5 * (np.percentile(points, 5, axis=0) + np.percentile(points, 95, axis=0))
            middle += (offset - normal @ middle) * normal
            matches += match_face(rotation, face, middle, surface, view)
    matches.sort(key=lambda match: -match.score)
    return _distinct([Pose(rotation @ CUBE_ROTATIONS[m.label], m.centre) for m in matches])


def _distinct(poses: list[Pose]) -> list[Pose]:
    """Poses in their order, without those that another one before them would be refined to."""
    kept: list[Pose] = []
    for pose in poses:
        near = (np.linalg.norm(pose.translation - other.translation) < 0.006 for other in kept)
        same = (np.trace(pose.rotation.T @ other.rotation) > 2.9 for other in kept)
        if not any(a and b for a, b in zip(near, same, strict=True)):
            kept.append(pose)
    return kept

"""Finds the die in one frame without a prior: planes give its axes, pips which face is which and where.

Slow (tens of ms): it runs in a worker while tracking goes on elsewhere, on a copy of the colours.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.die import CUBE_ROTATIONS
from services.perception.cpu.face_match import Match, match_face
from services.perception.cpu.fit import Fit, Fitter
from services.perception.cpu.labels import LABELS, bayes, relabelled
from services.perception.cpu.normals import (
    Oriented,
    cube_axes,
    free_turns,
    oriented_points,
    planes_along,
    spread_rotations,
)
from services.perception.cpu.pose import Float64, Pose, angle_rad
from services.perception.cpu.seeds import find_seeds
from services.perception.cpu.surface import Surface
from services.perception.cpu.view import View, colours_around, look_up
from services.perception.frames import Frame

_RADIUS_M = 0.075
_STARTS = spread_rotations(24)
_TURNS = 6  # of a single face, over a right angle
_CERTAIN, _HOPELESS, _TRIED = 1.6, 0.9, 2  # scores of fits, and after how many one gives up
_CLEAR_PIPS = 0.9


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
        if best is not None and _certain(best.fit):
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
    for tried, start in enumerate(_hypotheses(fitter, view, seed, most)):
        fit = fitter.fit(start, None, view)
        if best is None or fit.score > best.score:
            best = fit
        if _certain(best) or (tried >= _TRIED and best.score < _HOPELESS):
            break
    if best is None or best.misplaced:
        return None
    found = _labelled(fitter.fit(best.pose, None, view, alone=True), before)
    # Pips of a wrong labelling have pulled the pose: once more, with those that it has.
    found = _labelled(fitter.fit(found.fit.pose, None, view, alone=True), before)
    return found if _accepted(found.fit) else None


def _certain(fit: Fit) -> bool:
    """Whether no other start needs to be tried."""
    return fit.score > _CERTAIN and not fit.poor


def _accepted(fit: Fit) -> bool:
    """Whether depth and outline, or depth and pips, agree with the pose.

    The outline may be lost where colours around are not known yet; pips that fit so well are no chance.
    """
    return not fit.strayed or (not fit.misplaced and fit.quality.pip_ncc > _CLEAR_PIPS)


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


def _hypotheses(fitter: Fitter, view: View, seed: Float64, most: int) -> list[Pose]:
    """Poses worth refining, at most `most`, the most likely first."""
    cloud = oriented_points(view, seed, _RADIUS_M)
    if len(cloud.points) < 40:
        return []
    axes, _ = cube_axes(cloud.normals, _STARTS)
    found = [
        (match, rotation)
        for rotation in free_turns(axes, cloud.normals, _TURNS)
        for match in _matches(rotation, cloud, fitter.surface, view)
    ]
    found.sort(key=lambda one: -one[0].score)
    return _distinct((Pose(turned @ CUBE_ROTATIONS[m.label], m.centre) for m, turned in found), most)


def _matches(rotation: Float64, cloud: Oriented, surface: Surface, view: View) -> list[Match]:
    """The faces of a cube turned by `rotation` that the planes among the points may be."""
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
    return matches


def _distinct(poses: Iterable[Pose], most: int) -> list[Pose]:
    """The first `most` poses, without those that another one before them would be refined to."""
    kept: list[Pose] = []
    for pose in poses:
        if len(kept) == most:
            break
        near = (np.linalg.norm(pose.translation - other.translation) < 0.006 for other in kept)
        same = (np.trace(pose.rotation.T @ other.rotation) > 2.9 for other in kept)
        if not any(a and b for a, b in zip(near, same, strict=True)):
            kept.append(pose)
    return kept

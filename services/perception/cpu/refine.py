"""Gauss-Newton on depth, pips and outline at once, from a predicted pose.

All three terms are in units of their own noise, so their weights are what one measurement is worth; noise
that neighbouring samples share (depth is smooth over 5 px) is part of that worth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2 as compiled_cv2
import numpy as np

from services.perception.cpu.contour_term import FacePaint, contour_term, face_paint, search
from services.perception.cpu.depth_term import depth_term
from services.perception.cpu.pip_term import pip_term
from services.perception.cpu.pose import Pose, motion, moved
from services.perception.cpu.samples import Samples, sample_faces
from services.perception.cpu.surface import Surface
from services.perception.cpu.terms import Float64, Normal, normal
from services.perception.cpu.view import View, bilinear

cv2: Any = compiled_cv2  # its stubs know neither dtypes nor optional maps


class Stage(NamedTuple):
    """How one iteration looks at the picture: coarse ones reach further, fine ones are more exact."""

    sharp: bool
    depth_cutoff_m: float
    pip_cutoff: float
    contour_px: float


STAGES = (
    Stage(False, 0.015, 1.0, 12.0),
    Stage(False, 0.012, 0.8, 10.0),
    Stage(True, 0.009, 0.6, 8.0),
    Stage(True, 0.007, 0.5, 6.0),
    Stage(True, 0.006, 0.4, 6.0),
)


@dataclass(frozen=True)
class Noise:
    """What one measurement of each kind is worth.

    `depth_per_m3`: deviation of a depth sample at 1 m; it grows with the third power of the distance, two for
    stereo and one because samples of a farther die share more of their noise. `pip`: of a brightness, as a
    share of the contrast; `brightness`: its part that does not shrink with the light, levels. `outline_px`,
    `crease_px`: of an edge in the picture, at best.
    """

    depth_per_m3: float = 0.038
    pip: float = 0.2
    brightness: float = 6.0
    outline_px: float = 1.0
    crease_px: float = 3.0
    occluded_m: float = 0.008
    violated_m: float = 0.012


@dataclass(frozen=True)
class Prior:
    """Where the die was expected, and how much that is worth: `information` (6, 6), inverse m² and rad²."""

    pose: Pose
    information: Float64


def trusted(samples: Samples, grid: int, noise: Noise) -> Float64:
    """Trust (N,) that a sample shows the die: 0 beside or behind something nearer, half without depth."""
    behind = samples.behind
    nearer = (behind < -noise.occluded_m).astype(np.uint8).reshape(-1, grid, grid)
    kernel = np.ones((3, 3), np.uint8)
    covered = (
        np.stack([cv2.dilate(face, kernel) for face in nearer]).ravel() if len(nearer) else nearer.ravel()
    )
    trust = np.where(np.isnan(behind), 0.5, behind < noise.violated_m)
    return trust * (covered == 0)


class Seen(NamedTuple):
    """What the view has at the samples of a pose: `trust` (N,) in each, and the faces' own colours."""

    samples: Samples
    trust: Float64
    paint: FacePaint


def see(pose: Pose, surface: Surface, view: View, noise: Noise, paint: FacePaint | None = None) -> Seen:
    """Sample the view; colours that are known from a pose nearby need not be measured again."""
    samples = sample_faces(pose, surface, view)
    trust = trusted(samples, surface.grid, noise)
    return Seen(samples, trust, face_paint(samples, surface, trust, view) if paint is None else paint)


def system(pose: Pose, seen: Seen, surface: Surface, view: View, *, noise: Noise, stage: Stage) -> Normal:
    """Normal equations of all terms at a pose, from what is seen there."""
    samples, trust, paint = seen
    sigma_m = noise.depth_per_m3 * float(pose.translation[2]) ** 3
    depth = depth_term(samples, surface, pose.translation, stage.depth_cutoff_m, sigma_m)
    texture = surface.sharp if stage.sharp else surface.soft
    picture = view.sharp if stage.sharp else view.soft
    brightness = bilinear(picture, samples.pixels).astype(np.float64)
    pips = pip_term(
        samples,
        texture,
        pose.rotation,
        brightness,
        trust,
        cutoff=stage.pip_cutoff,
        sigma=noise.pip,
        sigma_brightness=noise.brightness,
    )
    borders = search(pose, surface, view, paint, stage.contour_px)
    contour = contour_term(borders, view, stage.contour_px, noise.outline_px, noise.crease_px)
    depth = depth._replace(weights=depth.weights * (trust > 0))
    parts = [normal(depth), normal(pips), normal(contour)]
    return Normal(np.sum([p.matrix for p in parts], axis=0), np.sum([p.vector for p in parts], axis=0))


_MOST_M, _MOST_RAD = 0.012, 0.2  # of one step
_NEAR_M, _NEAR_RAD = 0.0015, 0.03  # after a smaller step, coarse stages are left out
_STILL_M, _STILL_RAD = 0.0001, 0.0015  # a smaller step is the last
_DAMPING = np.diag([0.1**-2] * 3 + [1.0**-2] * 3)  # nobody is surer of less than 100 mm and 1 rad


def refine(
    start: Pose, prior: Prior | None, surface: Surface, view: View, noise: Noise
) -> tuple[Pose, Float64]:
    """The pose nearby that fits best, and its information (6, 6): the inverse of its covariance."""
    pose, information = start, _DAMPING
    paint: FacePaint | None = None
    near, fine = False, False
    for stage in STAGES:
        if near and not stage.sharp:
            continue
        seen = see(pose, surface, view, noise, paint if stage.sharp is fine else None)
        paint, fine = seen.paint, stage.sharp
        equations = system(pose, seen, surface, view, noise=noise, stage=stage)
        information, vector = equations.matrix, equations.vector
        if prior is not None:
            information = information + prior.information
            vector = vector + prior.information @ motion(prior.pose, pose)
        information = information + _DAMPING
        step = -np.asarray(np.linalg.solve(information, vector), np.float64)
        pose = moved(pose, _bounded(step))
        shift, turn = np.abs(step[:3]).max(), np.abs(step[3:]).max()
        near = bool(shift < _NEAR_M and turn < _NEAR_RAD)
        if stage.sharp and shift < _STILL_M and turn < _STILL_RAD:
            break
    return pose, information


def _bounded(step: Float64) -> Float64:
    """The step (6,), shortened to what one iteration can be right about."""
    longest = max(np.linalg.norm(step[:3]) / _MOST_M, np.linalg.norm(step[3:]) / _MOST_RAD, 1.0)
    return step / longest

"""Pips: the brightness of each face is that of its texture, brightened and scaled by the light on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from services.perception.cpu.samples import Samples
from services.perception.cpu.surface import Texture
from services.perception.cpu.terms import Float64, Term, cross, dot, tukey


class Light(NamedTuple):
    """Of each visible face (V,): brightness of a pip, and how much brighter the body is."""

    pip: Float64
    contrast: Float64


def fit_light(brightness: Float64, levels: Float64, trust: Float64) -> Light:
    """Weighted least squares of brightness (V, P) on texture levels (V, P), with weights `trust` (V, P).

    A face whose texture seems inverted has no contrast.
    """
    total = np.maximum(trust.sum(axis=1), 1e-9)
    mean_level = (trust * levels).sum(axis=1) / total
    mean_seen = (trust * brightness).sum(axis=1) / total
    deviation = levels - mean_level[:, None]
    spread = np.maximum((trust * deviation**2).sum(axis=1), 1e-9)
    shared = (trust * deviation * (brightness - mean_seen[:, None])).sum(axis=1)
    contrast = np.maximum(shared / spread, 0.0)
    return Light(mean_seen - contrast * mean_level, contrast)


def pip_term(
    samples: Samples,
    texture: Texture,
    rotation: Float64,
    brightness: Float64,
    trust: Float64,
    *,
    cutoff: float,
    sigma: float,
    sigma_brightness: float,
) -> Term:
    """Differences (N,) of seen and expected brightness, as shares of a face's contrast.

    `brightness` (N,) was read at the samples' pixels, `trust` (N,) is 0 where something is in front. On a ray
    d that meets the face (normal n) at the arm y, a motion moves the texture by -m·(dp + dw x y), where
    m = g - n (g·d)/(n·d) and g is the texture's gradient. `cutoff` and `sigma` are shares of the contrast,
    `sigma_brightness` is a deviation on top, in levels.
    """
    faces = len(samples.faces)
    seen, trusted = brightness.reshape(faces, -1), trust.reshape(faces, -1)
    levels = texture.levels[0, samples.faces]
    light = fit_light(seen, levels, trusted)
    share = np.maximum(light.contrast, 1e-3)
    residuals = ((seen - light.pip[:, None]) / share[:, None] - levels).ravel()
    variance = sigma**2 + (sigma_brightness / share) ** 2
    weights = trust * tukey(residuals, cutoff) * samples.per_sample(1 / variance)
    return Term(residuals, texture_jacobian(samples, texture, rotation), weights)


def texture_jacobian(samples: Samples, texture: Texture, rotation: Float64) -> Float64:
    """Derivative (N, 6) of minus the texture's level, at fixed pixels, by a motion of the die."""
    gradients = texture.gradients[samples.faces].reshape(-1, 3) @ rotation.T
    normals = samples.per_sample(samples.normals)
    slant = dot(gradients, samples.points) / dot(normals, samples.points)
    along = gradients - slant[:, None] * normals
    return np.concatenate([along, cross(samples.arms, along)], axis=1)

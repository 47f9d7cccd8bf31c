"""Depth: measured points lie on the die's faces (projective point-to-plane)."""

from __future__ import annotations

import numpy as np

from services.perception.cpu.samples import Samples
from services.perception.cpu.surface import Surface
from services.perception.cpu.terms import Float64, Term, cross, dot, tukey


def depth_term(samples: Samples, surface: Surface, centre: Float64, cutoff_m: float, sigma_m: float) -> Term:
    """Distances (N,) m of the measured points from the planes of the faces that they were read for.

    With q the measured point, n the face's normal and h half an edge: r = n·(q - centre) - h, hence
    dr/dp = -n and dr/dw = n x (q - centre). Beyond `cutoff_m` a point is on something else.
    """
    arms = samples.seen[:, None] * samples.rays - centre
    normals = samples.per_sample(samples.normals)
    residuals = dot(normals, arms) - surface.half
    jacobian = np.concatenate([-normals, cross(normals, arms)], axis=1)
    weights = tukey(residuals, cutoff_m) * (samples.seen > 0) / sigma_m**2
    return Term(residuals, jacobian, weights)

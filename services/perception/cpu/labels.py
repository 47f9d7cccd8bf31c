"""Which of the 24 labellings of the cube is the die's: a Bayes filter over frames.

Geometry cannot tell them apart, pips can. Frames are not independent (the same blur, the same shadow), so
each counts for less than its samples would; and tracking may slip by a quarter turn, so old evidence fades.
Letters: K 24 labellings, V visible faces, P samples a face.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.die import CUBE_ROTATIONS

Float64 = NDArray[np.float64]

LABELS = len(CUBE_ROTATIONS)


def unexplained(brightness: Float64, levels: Float64, trust: Float64) -> tuple[Float64, float]:
    """What each labelling leaves unexplained (K,), and all there is to explain: sums of squares.

    `brightness` and `trust` (V, P), texture `levels` (K, V, P). Each face has its own light: brightness is a
    level times a contrast, which cannot be negative, plus an offset, by weighted least squares.
    """
    left, total = np.zeros(len(levels)), 0.0
    for face in range(len(brightness)):
        weights, seen = trust[face], brightness[face]
        count = max(float(weights.sum()), 1e-9)
        centred = seen - float(weights @ seen) / count
        about = float(weights @ centred**2)
        shared = levels[:, face] @ (weights * centred)
        mean = levels[:, face] @ weights
        spread = np.maximum((levels[:, face] ** 2) @ weights - mean**2 / count, 1e-9)
        explained = np.maximum(shared, 0.0) ** 2 / spread
        left += np.maximum(about - explained, 0.0)
        total += about
    return left, total


def log_likelihood(left: Float64, noise: float, worth: float, most: float) -> Float64:
    """Log-likelihoods (K,), the best 0, of what labellings leave unexplained (K,), with its scale unknown.

    Gaussian errors of unknown deviation give -n/2 log(left); `noise` is the sum of squares that is there in
    any case, `worth` is n, what the samples count for, and no labelling falls below -`most` in one frame.
    """
    chance = -0.5 * worth * np.log(left + noise)
    return np.maximum(chance - chance.max(), -most)


def bayes(posterior: Float64, likelihood: Float64, slip: float) -> Float64:
    """Posterior (K,) after a frame with log-likelihoods (K,); `slip`: the chance to have lost count."""
    prior = (1 - slip) * posterior + slip / len(posterior)
    joint = prior * np.exp(likelihood - likelihood.max())
    return joint / joint.sum()


def relabelled(posterior: Float64, label: int) -> Float64:
    """The posterior (K,) in terms of the pose that is turned by CUBE_ROTATIONS[label]."""
    return posterior[_AFTER[label]]


def _composition() -> NDArray[np.int64]:
    """Table (K, K): [a, b] is the number of CUBE_ROTATIONS[a] @ CUBE_ROTATIONS[b]."""
    products = np.einsum("aij,bjk->abik", CUBE_ROTATIONS, CUBE_ROTATIONS)
    match = np.einsum("abij,cij->abc", products, CUBE_ROTATIONS)
    return np.argmax(match, axis=-1)


_AFTER = _composition()

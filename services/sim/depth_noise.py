"""What a D435 makes of true depth: correlated disparity noise, smeared edges, stereo shadow, holes, steps.

Refitted to a real D435 recording (librealsense, single_depth_color_640x480.bag): plane-fit residuals of
0.05 px disparity, correlated over 3 to 4 px, edges smeared, not speckled. White noise flatters a tracker.
Published form: sigma_z = z² · sigma_d / (f · B). Letters: h, w the stereo camera's own, coarser pixel grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from services.sim.camera import Optics

cv2: Any = compiled_cv2  # its stubs do not know which type an array keeps
Float32 = NDArray[np.float32]
_EDGE_PX = 1.0  # disparity between neighbours: more than on any surface that is not grazing


@dataclass(frozen=True)
class DepthNoise:
    """Strength of each part; lengths in pixels of the stereo camera."""

    disparity_px: float = 0.085  # correlated, new in each frame; a local plane fit takes a part of it away
    correlation_px: float = 2.9
    slow_px: float = 0.03  # wide, and the same for about a second: bends surfaces
    slow_correlation_px: float = 25.0
    slow_seconds: float = 1.0
    smear_px: float = 0.8  # Gaussian: the matching window runs over edges
    fattening_px: int = 1  # how far the nearer surface grows at an edge
    hole_share: float = 0.015  # patches without a match
    grazing_cosine: float = 0.20  # surfaces seen flatter than this give nothing
    nearest_m: float = 0.175
    step_px: float = 1 / 32
    unit_m: float = 0.001


class DepthSensor:
    """Turns true depth pictures into measured ones; keeps the slow part of the noise from frame to frame."""

    def __init__(self, optics: Optics, noise: DepthNoise, seed: int, rate_hz: float) -> None:
        ratio = optics.stereo_focal_px / optics.focal_px
        self._size = round(optics.width * ratio), round(optics.height * ratio)
        self._full = optics.width, optics.height
        self._focal_px = optics.stereo_focal_px
        self._scale = np.float32(optics.stereo_focal_px * optics.stereo_baseline_m)
        self._noise = noise
        self._rng = np.random.default_rng(seed)
        self._keep = float(np.exp(-1.0 / (noise.slow_seconds * rate_hz)))
        self._slow = self._field(noise.slow_correlation_px)

    def measure(self, depth_m: Float32) -> NDArray[np.uint16]:
        """Measured depth (H, W) in units of `unit_m`, 0 where there is none, from true depth (H, W) m."""
        true = cv2.resize(depth_m, self._size, interpolation=cv2.INTER_NEAREST_EXACT)
        disparity = np.divide(self._scale, true, out=np.zeros_like(true), where=true > 0)
        lost = self._lost(true, disparity)
        matched = self._matched(disparity) + self._error()
        steps = np.rint(matched / self._noise.step_px) * self._noise.step_px
        lost |= steps < self._noise.step_px
        depth = self._scale / np.where(lost, 1.0, steps)
        counts = np.where(lost | (depth < self._noise.nearest_m), 0.0, np.rint(depth / self._noise.unit_m))
        small = np.clip(counts, 0, np.iinfo(np.uint16).max).astype(np.uint16)
        return cv2.resize(small, self._full, interpolation=cv2.INTER_NEAREST_EXACT)

    def _matched(self, disparity: Float32) -> Float32:
        """Disparity (h, w) as block matching sees it: nearer surfaces grow, edges are smeared."""
        side = 2 * self._noise.fattening_px + 1
        fat = cv2.dilate(disparity, np.ones((side, side), np.uint8))
        # At edges only: grown everywhere, a slope would lie nearer than it is.
        fat = np.where(fat - disparity > _EDGE_PX, fat, disparity)
        smear = self._noise.smear_px
        return cv2.GaussianBlur(fat, (0, 0), smear) if smear > 0 else fat

    def _error(self) -> Float32:
        """Disparity noise (h, w): the slow part follows a first-order autoregression."""
        noise, keep = self._noise, self._keep
        fresh = self._field(noise.slow_correlation_px)
        self._slow = keep * self._slow + np.sqrt(1.0 - keep**2, dtype=np.float32) * fresh
        fast = self._field(noise.correlation_px)
        return np.float32(noise.disparity_px) * fast + np.float32(noise.slow_px) * self._slow

    def _lost(self, true: Float32, disparity: Float32) -> NDArray[np.bool_]:
        """Where (h, w) the right eye sees something else, the surface is too oblique, or nothing matches."""
        columns = np.arange(disparity.shape[1], dtype=np.float32)
        in_right = columns - disparity
        nearest = np.minimum.accumulate(in_right[:, ::-1], axis=1)[:, ::-1]
        shadow = in_right > nearest + 1.0
        across, down = _slope(true, 1), _slope(true, 0)
        steepness = (across**2 + down**2) * (self._focal_px / np.maximum(true, 0.05)) ** 2
        grazing = steepness > 1.0 / max(self._noise.grazing_cosine, 1e-3) ** 2 - 1.0
        return (true <= 0) | shadow | grazing | self._holes()

    def _holes(self) -> NDArray[np.bool_]:
        """Patches (h, w): the highest `hole_share` of a field of normal values."""
        share = self._noise.hole_share
        if share <= 0:
            return np.zeros(self._size[::-1], np.bool_)
        threshold = np.sqrt(2.0) * _inverse_erf(1.0 - 2.0 * share)
        return self._field(2.0) > threshold

    def _field(self, correlation_px: float) -> Float32:
        """Smooth normal noise (h, w) of deviation 1, drawn coarsely and enlarged."""
        grain = max(correlation_px / 1.5, 1.0)
        width, height = (int(np.ceil(side / grain)) + 8 for side in self._size)
        white = self._rng.standard_normal((height, width), np.float32)
        sigma = correlation_px / grain
        smooth = cv2.GaussianBlur(white, (0, 0), sigma)
        smooth *= np.float32(2.0 * np.sqrt(np.pi) * sigma)  # 1 / its deviation
        shift = self._rng.uniform(1.0, 3.0, 2)
        move = np.array([[1 / grain, 0.0, shift[0]], [0.0, 1 / grain, shift[1]]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(smooth, move, self._size, flags=flags, borderMode=cv2.BORDER_REFLECT)


def _slope(depth: Float32, axis: int) -> Float32:
    """The smaller of both one-sided differences: edges of surfaces are not slopes."""
    difference = np.diff(depth, axis=axis)
    first = np.concatenate([difference.take([0], axis), difference], axis)
    last = np.concatenate([difference, difference.take([-1], axis)], axis)
    return np.minimum(np.abs(first), np.abs(last))


def _inverse_erf(value: float) -> float:
    """Winitzki's approximation, exact to 0.002."""
    a, logarithm = 0.147, np.log(1.0 - value * value)
    inner = 2.0 / (np.pi * a) + logarithm / 2.0
    return float(np.sign(value) * np.sqrt(np.sqrt(inner**2 - logarithm / a) - inner))

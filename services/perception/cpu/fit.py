"""One fit of the die to a frame: refined from a start, judged, and compared with all 24 labellings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from services.perception.backend import Quality
from services.perception.cpu.colours import ColourModel
from services.perception.cpu.contour_term import edge_agreement, search
from services.perception.cpu.labels import log_likelihood, unexplained
from services.perception.cpu.pose import Float64, Pose, orthonormal
from services.perception.cpu.refine import Noise, Prior, refine, see
from services.perception.cpu.samples import Samples
from services.perception.cpu.surface import Surface
from services.perception.cpu.view import Camera, View, bilinear, crop_around, view_of
from services.perception.frames import Frame
from services.perception.quality import judge

_REACH = 1.74  # half edges: all of the die lies within this of its centre
_EDGE_PX = 8.0
_LEAST_PX = 16  # a smaller crop shows too little


@dataclass(frozen=True)
class Tuning:
    """What the tracker goes by; chosen on the tuning sequences of `bench.perception`."""

    noise: Noise = field(default_factory=Noise)
    margin_px: int = 26
    acceleration_m_s2: float = 12.0
    acceleration_rad_s2: float = 200.0
    prior_m: float = 0.004
    prior_rad: float = 0.06
    pip_noise: float = 12.0  # levels of a brightness that no labelling explains
    pip_worth: float = 0.02  # independent measurements a sample, of one frame among many like it
    pip_worth_alone: float = 0.06  # of a frame that is judged alone
    most_evidence: float = 2.0
    slip: float = 1e-5
    slip_when_poor: float = 0.005
    learn_every: int = 4


class Fit(NamedTuple):
    """A refined pose, its information (6, 6), and how the frame fits it."""

    pose: Pose
    information: Float64
    samples: Samples
    likelihood: Float64  # (24,) log, of the labellings
    quality: Quality
    edges: float  # share of the outline that is where it should be
    attempts: int = 1  # starts that were tried

    @property
    def score(self) -> float:
        """For comparing fits of one frame; more is better."""
        quality = self.quality
        return quality.consistent - 2 * quality.violated + 0.7 * quality.pip_ncc + 0.5 * self.edges

    @property
    def least_known_deg(self) -> float:
        """Deviation of the rotation about the axis that is known least."""
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1])))

    @property
    def covariance(self) -> Float64:
        """Covariance (6, 6) of (dp, dw), m and rad."""
        return np.asarray(np.linalg.inv(self.information), np.float64)

    @property
    def misplaced(self) -> bool:
        """Whether depth contradicts the pose."""
        quality = self.quality
        return quality.violated > 0.10 or quality.consistent < max(0.15, 0.6 * (1 - quality.occluded))

    @property
    def strayed(self) -> bool:
        """Whether depth or outline disagree with the pose."""
        return self.misplaced or self.quality.violated > 0.06 or self.edges < 0.7

    @property
    def poor(self) -> bool:
        """Whether it is too poor to learn from, or to trust its motion."""
        return self.strayed or self.quality.pip_ncc < 0.6


@dataclass(frozen=True)
class Fitter:
    """A die's surface, its colours as known now, and how to weigh what is seen."""

    surface: Surface
    colours: ColourModel
    tuning: Tuning

    def view(self, frame: Frame, about: Pose, extra_px: int = 0) -> View | None:
        """The crop of a frame around a pose; None where the die would be out of the picture."""
        matrix = frame.camera_matrix
        camera = Camera(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        reach, margin = _REACH * self.surface.half, self.tuning.margin_px + extra_px
        crop = crop_around(about, camera, frame.depth.shape, reach, margin)
        if crop.right - crop.left < _LEAST_PX or crop.bottom - crop.top < _LEAST_PX:
            return None
        return view_of(frame, camera, crop, self.colours.odds, self.surface.channel)

    def fit(self, start: Pose, prior: Prior | None, view: View, alone: bool = False) -> Fit:
        """Refine a pose and judge it; `alone`: the labelling will be read from this frame only."""
        tuning = self.tuning
        pose, weight = refine(start, prior, self.surface, view, tuning.noise)
        pose = Pose(orthonormal(pose.rotation), pose.translation)
        samples, trust, paint = see(pose, self.surface, view, tuning.noise)
        left, total = self._unexplained(samples, trust, view)
        count = float(trust.sum())
        worth, most = (tuning.pip_worth_alone, np.inf) if alone else (tuning.pip_worth, tuning.most_evidence)
        likelihood = log_likelihood(left, tuning.pip_noise**2 * count + 1.0, worth * count, most)
        edges = edge_agreement(search(pose, self.surface, view, paint, _EDGE_PX), _EDGE_PX)
        return Fit(pose, weight, samples, likelihood, judge(samples, float(left[0]), total), edges)

    def _unexplained(self, samples: Samples, trust: Float64, view: View) -> tuple[Float64, float]:
        """Sums of squares left by each labelling (24,), and of all."""
        shape = (len(samples.faces), self.surface.points.shape[1])
        seen = bilinear(view.sharp, samples.pixels).astype(np.float64).reshape(shape)
        return unexplained(seen, self.surface.sharp.levels[:, samples.faces], trust.reshape(shape))

"""Poses of other backends, refined and judged by the CPU tracker's own fit: one gate for everybody."""

from __future__ import annotations

import numpy as np

from common.camera_messages import PoseState
from common.die import Die
from services.perception.backend import PoseEstimate, Quality
from services.perception.cpu.backend import Gate
from services.perception.cpu.fit import Fit
from services.perception.cpu.labels import LABELS, bayes
from services.perception.cpu.pose import from_matrix, motion, to_matrix
from services.perception.cpu.tracker import Tracker
from services.perception.frames import Float64, Frame

# A pose that has to be moved by more than this to fit what is seen was not right.
MOST_M, MOST_RAD = 0.008, 0.15
_NOTHING = Quality(0.0, 0.0, 0.0, 0.0)
_UNKNOWN = np.diag([0.1**2] * 3 + [1.0] * 3)  # m², rad²: anywhere nearby, turned in any way


class Polisher:
    """Knows nothing of earlier frames: each pose is judged by its own."""

    def __init__(self, die: Die, gate: Gate | None = None) -> None:
        self._fitter = Tracker(die).fitter
        self._gate = gate or Gate()

    def judge(self, frame: Frame, T_camera_die: Float64) -> PoseEstimate:
        """The pose (4, 4) refined; TRACKING and claimed if it fits, and did so before as well."""
        start, even = from_matrix(T_camera_die), np.full(LABELS, 1.0 / LABELS)
        view = self._fitter.view(frame, start)
        if view is None:
            return _estimate(frame, T_camera_die, _UNKNOWN, even, _NOTHING, good=False)
        fit = self._fitter.fit(start, None, view, alone=True)
        posterior = bayes(even, fit.likelihood, 0.0)
        moved = motion(start, fit.pose)
        near = bool(np.linalg.norm(moved[:3]) <= MOST_M and np.linalg.norm(moved[3:]) <= MOST_RAD)
        good = near and self._fits(fit) and float(posterior[0]) > self._gate.label
        return _estimate(frame, to_matrix(fit.pose), fit.covariance, posterior, fit.quality, good=good)

    def _fits(self, fit: Fit) -> bool:
        quality, gate = fit.quality, self._gate
        seen = quality.consistent > gate.consistent and quality.violated < gate.violated
        known = fit.least_known_deg < gate.rotation_deg and quality.pip_ncc > gate.pip_ncc
        return not fit.misplaced and seen and known and fit.edges > gate.edges


def _estimate(
    frame: Frame, pose: Float64, covariance: Float64, posterior: Float64, quality: Quality, *, good: bool
) -> PoseEstimate:
    return PoseEstimate(
        state=PoseState.TRACKING if good else PoseState.SUSPECT,
        claimed=good,
        T_camera_die=pose,
        covariance=covariance,
        label_posterior=posterior,
        quality=quality,
        t_ns=frame.t_ns,
        frame_number=frame.frame_number,
    )

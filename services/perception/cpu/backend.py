"""The default backend: everything on one CPU core, without weights or a renderer."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.camera_messages import PoseState
from common.die import Die
from services.perception.backend import PoseEstimate, Unseen
from services.perception.cpu.fit import Fit, Tuning
from services.perception.cpu.pose import Float64, Pose, from_matrix, to_matrix
from services.perception.cpu.register import Before, register
from services.perception.cpu.tracker import Tracker
from services.perception.frames import Frame


@dataclass(frozen=True)
class Gate:
    """When a pose is good enough to learn and to be rewarded from; see `Quality` for the fractions."""

    pip_ncc: float = 0.55
    violated: float = 0.10
    consistent: float = 0.20
    label: float = 0.9
    label_to_begin: float = 0.8
    turn_rad: float = 0.3  # by which a die may have turned since it was lost, one deviation: at once ...
    turn_rad_s: float = 1.5  # ... and with time
    edges: float = 0.6  # share of the outline that is where it should be
    rotation_deg: float = 4.0  # one standard deviation along the least known axis
    lost_after: int = 3  # bad frames in a row
    good_after_loss: int = 2  # good frames in a row before a pose is claimed again
    catch_up: int = 12  # frames kept from the search on, to follow the die to now once it is found


class CpuBackend:
    """Sparse tracker; see `PoseBackend` for what its methods promise."""

    def __init__(self, die: Die, tuning: Tuning | None = None, gate: Gate | None = None) -> None:
        self._tracker = Tracker(die, tuning)
        self._gate = gate or Gate()
        self._state = PoseState.SEARCHING
        self._bad = 0
        self._good = 0
        self._seen: tuple[Pose, int] | None = None  # where the die was when it was last sure, and when
        self._recent: deque[Frame] = deque(maxlen=self._gate.catch_up)

    def register(self, frame: Frame, mask: NDArray[np.bool_] | None = None) -> PoseEstimate | Unseen:
        """Find the die without a prior; changes nothing here."""
        found = register(frame, self._tracker.fitter, self._before(frame), mask)
        if found is None:
            return self._unseen(frame, "no die found in the picture")
        return self._estimate(frame, found.fit, found.posterior, claimed=False)

    def _before(self, frame: Frame) -> Before | None:
        """Where the die was when it was last followed."""
        seen = self._seen  # read once: the other thread may forget it meanwhile
        if seen is None:
            return None
        pose, t_ns = seen
        since_s = max(0.0, (frame.t_ns - t_ns) / 1e9)
        return Before(pose, self._gate.turn_rad + self._gate.turn_rad_s * since_s)

    def adopt(self, found: PoseEstimate) -> None:
        """Follow the die from a pose of `register`, through the frames that came since.

        A pose whose faces are not known is followed, but not told until they are.
        """
        if not self._searching:
            return  # found again on its own meanwhile
        surer = found.label_posterior[0] > self._tracker.posterior[0]
        if self._good and not surer:
            return
        self._tracker.start(from_matrix(found.T_camera_die), found.t_ns, found.label_posterior)
        self._bad = self._good = 0
        for frame in [frame for frame in self._recent if frame.t_ns > found.t_ns]:
            if self._tracker.step(frame) is None:
                break
        if self._tracker.posterior[0] >= self._gate.label_to_begin:
            self._state = PoseState.SUSPECT

    def track(self, frame: Frame) -> PoseEstimate | Unseen:
        """The pose in this frame from the one before."""
        if self._searching:
            self._recent.append(frame)
            return self._watch(frame)
        self._recent.clear()
        fit = self._tracker.step(frame)
        fits = fit is not None and self._fits(fit)
        self._count(fits)
        if fit is None or self._bad >= self._gate.lost_after:
            self._state = PoseState.LOST
            return self._unseen(frame, "lost the die; searching")
        return self._told(frame, fit, fits)

    def _watch(self, frame: Frame) -> PoseEstimate | Unseen:
        """While searching: whether the die is still where it was last, or its faces are known by now."""
        fit = self._tracker.step(frame, thorough=self._good > 0)
        fits = fit is not None and self._fits(fit) and not fit.poor
        self._count(fits)
        if fit is None or not fits:
            return self._unseen(frame, f"{'lost' if self._lost else 'searching for'} the die")
        if self._tracker.posterior[0] < self._gate.label_to_begin:
            return self._unseen(frame, "a die, but what is seen of it could be several of its faces")
        return self._told(frame, fit, fits)

    def _told(self, frame: Frame, fit: Fit, fits: bool) -> PoseEstimate:
        """The estimate of a pose that is followed."""
        sure = fits and self._good >= self._gate.good_after_loss and self._knows(fit)
        self._state = PoseState.TRACKING if sure else PoseState.SUSPECT
        if sure:
            self._seen = fit.pose, frame.t_ns
        return self._estimate(frame, fit, self._tracker.posterior, sure)

    @property
    def _searching(self) -> bool:
        return self._state in (PoseState.SEARCHING, PoseState.LOST)

    @property
    def _lost(self) -> bool:
        return self._state is not PoseState.SEARCHING

    def _count(self, fits: bool) -> None:
        self._bad, self._good = (0, self._good + 1) if fits else (self._bad + 1, 0)

    def reset(self) -> None:
        """Forget everything: SEARCHING."""
        self._tracker.forget()
        self._seen = None
        self._state, self._bad, self._good = PoseState.SEARCHING, 0, 0
        self._recent.clear()

    def _fits(self, fit: Fit) -> bool:
        """Whether the frame agrees with the pose, whatever the labelling."""
        quality, gate = fit.quality, self._gate
        return not fit.misplaced and quality.violated < gate.violated and quality.consistent > gate.consistent

    def _knows(self, fit: Fit) -> bool:
        """Whether the pose is known well enough, and its labelling."""
        gate = self._gate
        known = fit.least_known_deg < gate.rotation_deg and fit.quality.pip_ncc > gate.pip_ncc
        known = known and fit.edges > gate.edges
        return known and float(self._tracker.posterior[0]) > gate.label

    def _estimate(self, frame: Frame, fit: Fit, posterior: Float64, claimed: bool) -> PoseEstimate:
        state = PoseState.TRACKING if self._state is PoseState.TRACKING else PoseState.SUSPECT
        return PoseEstimate(
            state=state,
            claimed=claimed,
            T_camera_die=to_matrix(fit.pose),
            covariance=fit.covariance,
            label_posterior=posterior,
            quality=fit.quality,
            t_ns=frame.t_ns,
            frame_number=frame.frame_number,
            attempts=fit.attempts,
        )

    def _unseen(self, frame: Frame, message: str) -> Unseen:
        state = PoseState.LOST if self._lost else PoseState.SEARCHING
        return Unseen(state, message, frame.t_ns, frame.frame_number)

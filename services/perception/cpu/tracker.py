"""Follows the die from frame to frame: predict, refine, judge, and read which of the 24 labellings it is."""

from __future__ import annotations

import numpy as np

from common.die import CUBE_ROTATIONS, Die
from services.perception.cpu.colours import ColourModel, colours_of
from services.perception.cpu.fit import Fit, Fitter, Tuning
from services.perception.cpu.labels import LABELS, bayes, relabelled
from services.perception.cpu.motion import Motion, expected_within, information
from services.perception.cpu.pose import Float64, Pose, exponential
from services.perception.cpu.refine import Prior
from services.perception.cpu.surface import surface_of
from services.perception.cpu.view import View, colours_around, look_up
from services.perception.frames import Frame

_TURN_RAD = 0.12  # by which a retry starts beside the prediction
_LABEL_SURE = 0.9
_LABEL_LEAST = 0.1  # below it no labelling is worth turning to
_BETTER = 0.02  # in score
_PATIENCE = 5
_REACH = 1.74  # half edges: all of the die lies within this of its centre
_LEAST_NCC = 0.6
_ON_DIE_M = 0.004


class Tracker:
    """One die, followed from a given pose."""

    def __init__(self, die: Die, tuning: Tuning | None = None) -> None:
        self._tuning = tuning or Tuning()
        self._surface = surface_of(die)
        self._paint = colours_of(die)
        self._colours: ColourModel = self._paint
        self._motion: Motion | None = None
        self._posterior = np.full(LABELS, 1.0 / LABELS)
        self._frames = 0
        self._patience = 0  # frames until other starts are tried again

    @property
    def fitter(self) -> Fitter:
        """A fitter with the colours as known now; later frames do not change it."""
        return Fitter(self._surface, self._colours, self._tuning)

    @property
    def posterior(self) -> Float64:
        """Posterior (24,) of the labellings of the last pose."""
        return self._posterior

    def start(self, pose: Pose, t_ns: int, posterior: Float64) -> None:
        """Follow the die from a pose seen at a time."""
        self._motion, self._posterior, self._frames = Motion(pose, t_ns), posterior, 0

    def forget(self) -> None:
        """Follow nothing; of colours only the die's paint is known again."""
        self._motion, self._posterior = None, np.full(LABELS, 1.0 / LABELS)
        self._colours = self._paint

    def step(self, frame: Frame, thorough: bool = True) -> Fit | None:
        """Find the die near where it should be by now; None when it left the picture or was never there.

        A fit that depth contradicts is answered but not followed. `thorough`: try other starts if it is poor.
        """
        if self._motion is None:
            return None
        predicted = self._motion.at(frame.t_ns)
        fitter = self.fitter
        view = fitter.view(frame, predicted)
        if view is None:
            return None
        if self._frames == 0:
            view = self._look_around(view, predicted)
            fitter = self.fitter
        prior = self._prior(predicted, (frame.t_ns - self._motion.t_ns) / 1e9)
        fit = fitter.fit(predicted, prior, view)
        self._patience = max(0, self._patience - 1)
        if thorough and self._patience == 0 and self._doubtful(fit):
            fit = self._retry(fitter, fit, predicted, view)
        if fit.misplaced:
            self._motion.coast(frame.t_ns)
            self._posterior = bayes(self._posterior, np.zeros(LABELS), self._tuning.slip_when_poor)
            return fit
        fit = self._read_label(fit)
        self._motion.follow(fit.pose, frame.t_ns, 0.3 if fit.poor else 1.0)
        if fit.quality.pip_ncc > _LEAST_NCC and self._frames % self._tuning.learn_every == 0:
            self._learn(fit, view)
        self._frames += 1
        return fit

    def _learn(self, fit: Fit, view: View) -> None:
        """Learn colours from a frame that fits: the die's where depth agrees, others' around it."""
        samples = fit.samples
        rows, columns = view.depth.shape
        at = np.clip(np.rint(samples.pixels).astype(np.int64), 0, (columns - 1, rows - 1))
        colours = view.colour[at[:, 1], at[:, 0]]
        around = colours_around(view, fit.pose.translation, _REACH * self._surface.half)
        covered = colours[samples.behind < -self._tuning.noise.occluded_m]
        on_die = colours[np.abs(samples.behind) < _ON_DIE_M]
        self._colours = self._colours.learned(on_die, np.concatenate([around, covered]))

    def _look_around(self, view: View, about: Pose) -> View:
        """Learn the colours around the die before its outline is looked for; the view with what they say."""
        around = colours_around(view, about.translation, _REACH * self._surface.half)
        self._colours = self._colours.learned(around[:0], around)
        return view._replace(odds=look_up(self._colours.odds, view.colour))

    def _prior(self, predicted: Pose, elapsed_s: float) -> Prior:
        tuning = self._tuning
        shift = expected_within(elapsed_s, tuning.acceleration_m_s2, tuning.prior_m)
        turn = expected_within(elapsed_s, tuning.acceleration_rad_s2, tuning.prior_rad)
        return Prior(predicted, information(shift, turn))

    def _doubtful(self, fit: Fit) -> bool:
        """Whether another start is worth its time: wrong pips may just be those of another labelling."""
        return fit.strayed or (fit.quality.pip_ncc < _LEAST_NCC and self._posterior[0] > _LABEL_SURE)

    def _retry(self, fitter: Fitter, fit: Fit, predicted: Pose, view: View) -> Fit:
        """The best of fits from other starts, if it is clearly better."""
        assert self._motion is not None
        axis = predicted.translation / np.linalg.norm(predicted.translation)
        angle = _TURN_RAD if self._frames % 2 else -_TURN_RAD  # one way now, the other way next time
        turned = Pose(exponential(angle * axis) @ predicted.rotation, predicted.translation)
        starts = self._motion.pose, turned
        best = fit
        for start in starts:
            other = fitter.fit(start, None, view)
            if other.score > best.score + _BETTER:
                best = other
        if best is fit:
            self._patience = _PATIENCE
        return best._replace(attempts=1 + len(starts))

    def _read_label(self, fit: Fit) -> Fit:
        slip = self._tuning.slip_when_poor if fit.poor else self._tuning.slip
        self._posterior = bayes(self._posterior, fit.likelihood, slip)
        best = int(np.argmax(self._posterior))
        if self._posterior[best] < max(2 * self._posterior[0], _LABEL_LEAST):
            return fit
        self._posterior = relabelled(self._posterior, best)
        assert self._motion is not None
        self._motion.pose = _turned(self._motion.pose, best)  # the die has not turned, its faces were misread
        return fit._replace(pose=_turned(fit.pose, best))


def _turned(pose: Pose, label: int) -> Pose:
    """The pose with the faces of another labelling."""
    return Pose(pose.rotation @ CUBE_ROTATIONS[label], pose.translation)

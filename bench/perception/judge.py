"""Run a backend through sequences as the service does with its default options, and judge each answer."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bench.perception import metrics
from bench.perception.library import Sequence
from common.dice import APPEARANCES
from services.perception.backend import PoseBackend, PoseEstimate, Unseen
from services.perception.frames import Frame

Float64 = NDArray[np.float64]

HIDDEN = 0.97  # covered by more than this, nothing can be known
_NEVER = np.full((4, 4), np.nan)


@dataclass
class Answers:
    """What a backend said of each frame (N) of one sequence, and how long it took."""

    poses: list[Float64] = field(default_factory=list[Float64])  # NaN where it gave none
    claimed: list[bool] = field(default_factory=list[bool])
    started: list[bool] = field(default_factory=list[bool])  # False until the first pose was told
    frame_ms: list[float] = field(default_factory=list[float])
    frame_cpu_ms: list[float] = field(default_factory=list[float])
    register_cpu_ms: list[float] = field(default_factory=list[float])
    attempts: list[int] = field(default_factory=list[int])  # 0 where it gave no pose

    def take(self, answer: PoseEstimate | Unseen, started: bool) -> None:
        """Append the answer to one frame."""
        seen = isinstance(answer, PoseEstimate)
        self.poses.append(answer.T_camera_die if isinstance(answer, PoseEstimate) else _NEVER)
        self.claimed.append(seen and answer.claimed)
        self.started.append(started)
        self.attempts.append(answer.attempts if isinstance(answer, PoseEstimate) else 0)


def follow(backend: PoseBackend, frames: Iterable[Frame], rate_hz: float) -> Answers:
    """Feed all frames; `register` runs beside, and its result comes as many frames later as it took.

    That time is taken in seconds of processor time, as on a core of its own. A search begins in each frame in
    which the die is not seen, unless one is under way, as the service's does with `search_pause_s` 0; here it
    may find the die anywhere in the picture, there within the hand's reach.
    """
    answers = Answers()
    started, pending = False, None
    for index, frame in enumerate(frames):
        wall, cpu = time.perf_counter(), time.thread_time()
        if pending is not None and index >= pending[0]:
            if isinstance(pending[1], PoseEstimate):
                backend.adopt(pending[1])
            pending = None
        answer = backend.track(frame)
        answers.frame_cpu_ms.append(1e3 * (time.thread_time() - cpu))
        answers.frame_ms.append(1e3 * (time.perf_counter() - wall))
        started = started or isinstance(answer, PoseEstimate)
        answers.take(answer, started)
        if isinstance(answer, Unseen) and pending is None:
            cpu = time.thread_time()
            found = backend.register(frame)
            took_s = time.thread_time() - cpu
            answers.register_cpu_ms.append(1e3 * took_s)
            pending = index + max(1, math.ceil(took_s * rate_hz)), found
    return answers


@dataclass(frozen=True)
class Judged:
    """Errors of all frames (N) of one sequence; NaN where there was no pose."""

    sequence: Sequence
    answers: Answers
    rotation_deg: Float64  # with the true labelling
    modulo_deg: Float64  # with the best of the 24
    translation_mm: Float64
    labelled: NDArray[np.bool_]
    claimed: NDArray[np.bool_]
    started: NDArray[np.bool_]

    @property
    def posed(self) -> NDArray[np.bool_]:
        """Where (N,) a pose was given."""
        return np.isfinite(self.translation_mm)

    @property
    def within(self) -> NDArray[np.bool_]:
        """Where (N,) the pose is right to 5 deg and 3 mm."""
        return (self.rotation_deg <= 5.0) & (self.translation_mm <= 3.0)

    @property
    def gross(self) -> NDArray[np.bool_]:
        """Where (N,) a pose is wrong by more than 10 deg or 10 mm."""
        return (self.rotation_deg > 10.0) | (self.translation_mm > 10.0)

    @cached_property
    def surface_errors_mm(self) -> dict[str, Float64]:
        """ADD, ADD-S and MSSD of the frames with a pose."""
        points = metrics.surface_points(APPEARANCES[self.sequence.spec.appearance].die)
        estimated = np.array(self.answers.poses)[self.posed]
        true = self.sequence.T_camera_die[: len(self.posed)][self.posed]
        kinds = {"add_mm": metrics.add_m, "add_s_mm": metrics.add_s_m, "mssd_mm": metrics.mssd_m}
        return {name: 1e3 * kind(estimated, true, points) for name, kind in kinds.items()}


def judge(sequence: Sequence, answers: Answers) -> Judged:
    """Compare answers with the truth."""
    estimated = np.array(answers.poses)
    true = sequence.T_camera_die[: len(estimated)]
    errors = np.degrees(metrics.rotation_errors_rad(estimated, true))
    return Judged(
        sequence=sequence,
        answers=answers,
        rotation_deg=errors[:, 0],
        modulo_deg=errors.min(axis=1),
        translation_mm=1e3 * metrics.translation_error_m(estimated, true),
        labelled=errors.argmin(axis=1) == 0,
        claimed=np.array(answers.claimed, np.bool_),
        started=np.array(answers.started, np.bool_),
    )


def reacquired_after(judged: Judged, room: int) -> list[int | None]:
    """For each time the die was hidden: frames from its return to a claimed pose within 5 deg and 3 mm.

    None where it did not come before the die was hidden again, or the sequence ended. Times that leave it
    fewer than `room` frames to come in are no trials.
    """
    hidden = judged.sequence.occlusion[: len(judged.claimed)] > HIDDEN
    returns = np.flatnonzero(hidden[:-1] & ~hidden[1:]) + 1
    ends = [*(np.flatnonzero(~hidden[:-1] & hidden[1:]) + 1), len(hidden)]
    good = judged.claimed & judged.within
    after: list[int | None] = []
    for first in returns:
        last = min(end for end in ends if end > first)
        if last - first < room:
            continue
        found = np.flatnonzero(good[first:last])
        after.append(int(found[0]) if len(found) else None)
    return after

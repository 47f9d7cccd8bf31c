"""What finds and follows the die: the protocol of all pose backends, and what they answer.

Letters: L 24 labellings, the rotations that map a cube onto itself (common.die.CUBE_ROTATIONS).
"""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.camera_messages import PoseState
from services.perception.frames import Float64, Frame


@dataclass(frozen=True)
class Quality:
    """How well what is seen fits a pose; the first three are fractions of the surface that it predicts.

    They need not add up to 1: what lies between, and where depth has no reading, is in none of them.
    """

    consistent: float  # depth within 8 mm of it
    occluded: float  # something nearer is in front
    violated: float  # depth is more than 12 mm behind: the best sign of a loss
    pip_ncc: float  # normalised correlation of the pips seen with those predicted, -1..1


@dataclass(frozen=True)
class PoseEstimate:
    """The die's pose in one frame, measured in that frame: an older pose is never given again as new."""

    state: PoseState  # TRACKING or SUSPECT
    claimed: bool  # good enough to learn and to be rewarded from
    T_camera_die: Float64  # (4, 4): metres, die's frame to OpenCV optical frame
    # (6, 6): m, rad. Small errors (dp, dw) in the camera's frame: p + dp, exp(dw) R; about the die's centre.
    covariance: Float64
    # (24,), sums to 1: T_camera_die · CUBE_ROTATIONS[l] is the true pose; 0 is the one given.
    label_posterior: Float64
    quality: Quality
    t_ns: int  # the frame's capture time
    frame_number: int
    attempts: int = 1  # fits from different starts that this frame needed


@dataclass(frozen=True)
class Unseen:
    """No pose in this frame, and why, for people."""

    state: PoseState  # SEARCHING or LOST
    message: str
    t_ns: int
    frame_number: int


class PoseBackend(Protocol):
    """Finds the die once (`register`, slow), then follows it (`track`, every frame).

    `register` may run in a worker thread while `track` goes on in another: it must not touch what `track`
    changes. Its answer is handed back through `adopt`.
    """

    def register(self, frame: Frame, mask: NDArray[np.bool_] | None = None) -> PoseEstimate | Unseen:
        """Find the die without a prior, where `mask` (H, W) allows it."""
        ...

    def adopt(self, found: PoseEstimate) -> None:
        """Follow the die from a pose of `register`, which may be some frames old by now."""
        ...

    def track(self, frame: Frame) -> PoseEstimate | Unseen:
        """The pose in this frame from the one before.

        Unseen before `adopt`, after a loss, and while nothing says which faces are seen.
        """
        ...

    def reset(self) -> None:
        """Forget everything: SEARCHING."""
        ...

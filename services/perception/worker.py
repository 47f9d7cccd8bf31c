"""The slow parts of perception, called from the runner's workers: backend, mask, palm tag, previews."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.camera_messages import CameraPreview, PoseState
from common.die import Die
from services.perception.backend import PoseBackend, PoseEstimate, Unseen
from services.perception.frames import Frame
from services.perception.overlay import annotated, depth_picture, jpeg
from services.perception.palm_tag import Mount, PalmTag
from services.perception.status import Said
from services.perception.swapped import red_and_blue_swapped

Mask = NDArray[np.bool_]
Segment = Callable[[Frame], "Mask | str"]  # where the die is, or in a few words why that is not known

SWAPPED = "red and blue are swapped: the camera sends BGR where RGB is wanted"


@dataclass(frozen=True)
class Look:
    """What a look at a picture as such tells."""

    mount: Mount
    offset_px: float  # of the palm's tag
    warning: str  # for people; empty: nothing
    preview: CameraPreview | None


class PoseWorker:
    """`track`, `adopt` and `reset` are called by one thread; `register` by a second, `look` by a third."""

    def __init__(self, backend: PoseBackend, segment: Segment, die: Die, tag: PalmTag | None) -> None:
        self._backend, self._segment, self._die, self._tag = backend, segment, die, tag

    def track(self, frame: Frame) -> PoseEstimate | Unseen:
        """Follow the die into a frame."""
        return self._backend.track(frame)

    def register(self, frame: Frame) -> PoseEstimate | Unseen:
        """Find the die where it may be."""
        mask = self._segment(frame)
        return _unseen(frame, mask) if isinstance(mask, str) else self._backend.register(frame, mask)

    def adopt(self, found: PoseEstimate) -> None:
        """Follow the die from what `register` found."""
        self._backend.adopt(found)

    def reset(self) -> None:
        """Forget the die."""
        self._backend.reset()

    def look(self, frame: Frame, estimate: PoseEstimate | None, said: Said, draw: bool) -> Look:
        """See whether the camera stands where it stood, and sends what it should; draw a preview."""
        mount = self._tag.look(frame.colour) if self._tag else Mount.UNKNOWN
        warning = self._tag.message() if self._tag else ""
        if not warning and red_and_blue_swapped(frame.colour, self._die):
            warning = SWAPPED
        return Look(
            mount,
            self._tag.offset_px if self._tag else 0.0,
            warning,
            self._preview(frame, estimate, said) if draw else None,
        )

    def _preview(self, frame: Frame, estimate: PoseEstimate | None, said: Said) -> CameraPreview:
        picture = annotated(frame, self._die, estimate, said.state, said.message)
        return CameraPreview(jpeg(picture), jpeg(depth_picture(frame)))


def _unseen(frame: Frame, why: str) -> Unseen:
    return Unseen(PoseState.SEARCHING, why, frame.t_ns, frame.frame_number)

"""Has the camera been knocked? A tag on the palm's base must stay where it was at calibration."""

# pyright: strict

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from services.perception.calibration import TagReference
from services.perception.config import KnockConfig
from services.perception.frames import Float64
from services.perception.tags import TagFinder

_MARGIN_PX = 40  # around the corners: there the tag is looked for first


class Mount(StrEnum):
    """What the tag says of the camera."""

    UNKNOWN = "unknown"  # no tag was calibrated, or it has not been seen yet
    STEADY = "steady"
    KNOCKED = "knocked"
    UNSEEN = "unseen"  # for so long that the camera may have been turned away from it


class PalmTag:
    """Looks at the tag now and then; hidden by fingers for a while, it leaves the last verdict as it is."""

    def __init__(self, reference: TagReference, config: KnockConfig) -> None:
        self._reference = reference
        self._config = config
        self._finder = TagFinder(reference.dictionary)
        self._expected = np.array(reference.corners_px, np.float64)
        self._off = 0  # looks in a row
        self._steady = 0
        self._unseen = 0
        self.mount = Mount.UNKNOWN
        self.offset_px = 0.0  # of the newest look that saw it

    def look(self, colour: NDArray[np.uint8]) -> Mount:
        """Look for the tag in a picture (H, W, 3), RGB: where it was calibrated, else anywhere."""
        seen = self._near(colour) or self._tags(colour)
        if seen:
            self._unseen = 0
            distances = np.linalg.norm(seen[0] - self._expected, axis=1)
            self._judge(float(distances.mean()))
        else:
            self._miss()
        return self.mount

    def _near(self, colour: NDArray[np.uint8]) -> list[Float64]:
        low = np.maximum(np.floor(self._expected.min(axis=0)).astype(int) - _MARGIN_PX, 0)
        high = np.ceil(self._expected.max(axis=0)).astype(int) + _MARGIN_PX
        inside = np.ascontiguousarray(colour[low[1] : high[1], low[0] : high[0]])
        return [pixels + low for pixels in self._tags(inside)] if inside.size else []

    def _tags(self, colour: NDArray[np.uint8]) -> list[Float64]:
        """Corners (4, 2) of the tag, once or not at all."""
        return [tag.pixels for tag in self._finder.find(colour) if tag.number == self._reference.number]

    def _miss(self) -> None:
        self._unseen += 1
        if self._unseen >= self._config.unseen_looks and self.mount is not Mount.KNOCKED:
            self.mount = Mount.UNSEEN
            self._off = self._steady = 0

    def _judge(self, offset_px: float) -> None:
        self.offset_px = offset_px
        off = offset_px > self._config.limit_px
        self._off, self._steady = (self._off + 1, 0) if off else (0, self._steady + 1)
        if self._off >= self._config.looks:
            self.mount = Mount.KNOCKED
        elif self._steady >= self._config.looks:
            self.mount = Mount.STEADY

    def message(self) -> str:
        """What a person should know and do; empty unless the camera was, or may have been, knocked."""
        if self.mount is Mount.UNSEEN:
            return (
                f"the palm's tag was not seen in {self._unseen} looks: "
                "is it covered, or has the camera been turned away?"
            )
        if self.mount is not Mount.KNOCKED:
            return ""
        return (
            f"camera knocked: the palm's tag is {self.offset_px:.1f} px from where it was calibrated, "
            f"at most {self._config.limit_px:g}: fix the camera and run calibrate again"
        )

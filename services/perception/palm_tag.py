"""Has the camera been knocked? A tag on the palm's base must stay where it was at calibration."""

# pyright: strict

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from services.perception.calibration import TagReference
from services.perception.config import KnockConfig
from services.perception.tags import TagFinder

_MARGIN_PX = 40  # around the corners: a camera knocked by more does not see the tag there any more


class Mount(StrEnum):
    """What the tag says of the camera."""

    UNKNOWN = "unknown"  # no tag was calibrated, or it has not been seen yet
    STEADY = "steady"
    KNOCKED = "knocked"


class PalmTag:
    """Looks at the tag now and then; hidden by fingers it says nothing, and the last verdict holds."""

    def __init__(self, reference: TagReference, config: KnockConfig) -> None:
        self._reference = reference
        self._config = config
        self._finder = TagFinder(reference.dictionary)
        self._expected = np.array(reference.corners_px, np.float64)
        self._off = 0  # looks in a row
        self._steady = 0
        self.mount = Mount.UNKNOWN
        self.offset_px = 0.0  # of the newest look that saw it

    def look(self, colour: NDArray[np.uint8]) -> Mount:
        """Look for the tag in a picture (H, W, 3), RGB."""
        low = np.maximum(np.floor(self._expected.min(axis=0)).astype(int) - _MARGIN_PX, 0)
        high = np.ceil(self._expected.max(axis=0)).astype(int) + _MARGIN_PX
        inside = np.ascontiguousarray(colour[low[1] : high[1], low[0] : high[0]])
        tags = self._finder.find(inside) if inside.size else []
        seen = [tag.pixels + low for tag in tags if tag.number == self._reference.number]
        if seen:
            distances = np.linalg.norm(seen[0] - self._expected, axis=1)
            self._judge(float(distances.mean()))
        return self.mount

    def _judge(self, offset_px: float) -> None:
        self.offset_px = offset_px
        off = offset_px > self._config.limit_px
        self._off, self._steady = (self._off + 1, 0) if off else (0, self._steady + 1)
        if self._off >= self._config.looks:
            self.mount = Mount.KNOCKED
        elif self._steady >= self._config.looks:
            self.mount = Mount.STEADY

    def message(self) -> str:
        """What a person should know and do; empty unless the camera was knocked."""
        if self.mount is not Mount.KNOCKED:
            return ""
        return (
            f"camera knocked: the palm's tag is {self.offset_px:.1f} px from where it was calibrated, "
            f"at most {self._config.limit_px:g}: fix the camera and run calibrate again"
        )

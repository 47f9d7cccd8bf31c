"""Where the die was last believed to be: one that is found too far from there is not claimed for a while.

A backend that has lost the die may find another one, and nothing in the picture says that it is not the same.
"""

# pyright: strict

from __future__ import annotations

import numpy as np
from pydantic import Field

from common.config import Frozen
from services.perception.filter import Measured

NS_PER_S = 1e9


class ElsewhereConfig(Frozen):
    """How far the die may have gone while nobody saw it."""

    distance_m: float = Field(default=0.02, ge=0.0, description="at once ...")
    speed_m_s: float = Field(default=0.2, gt=0.0, description="... and with time")
    doubt_s: float = Field(
        default=1.0, gt=0.0, description="a die found farther off is not claimed for so long, then believed"
    )


class LastPlace:
    """The newest claimed position, in the frame of what it is given."""

    def __init__(self, config: ElsewhereConfig) -> None:
        self._config = config
        self._last: Measured | None = None
        self._doubted_ns: int | None = None  # since when a die is seen elsewhere

    def doubt(self, measured: Measured) -> str:
        """Why this die may be another one; empty if it may be the one, or has been there for long enough."""
        if self._last is None:
            return ""
        begin_ns = measured.t_ns if self._doubted_ns is None else self._doubted_ns
        since_s = max(0.0, (begin_ns - self._last.t_ns) / NS_PER_S)
        away_m = float(np.linalg.norm(measured.position - self._last.position))
        possible = away_m <= self._config.distance_m + since_s * self._config.speed_m_s
        if possible or measured.t_ns - begin_ns >= self._config.doubt_s * NS_PER_S:
            return ""
        self._doubted_ns = begin_ns
        where = f"the pose jumped by {1e3 * away_m:.0f} mm in {since_s:.1f} s"
        return f"{where}: a second die? It is believed after {self._config.doubt_s:g} s"

    def claimed(self, measured: Measured) -> None:
        """The die is here."""
        self._last, self._doubted_ns = measured, None

    def forget(self) -> None:
        """The die may be anywhere."""
        self._last, self._doubted_ns = None, None

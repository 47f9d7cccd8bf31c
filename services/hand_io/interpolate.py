"""From the planner's few actions a second to the wire's many set points."""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Ramp:
    """A straight way (A,) rad from `begin_rad`, at `start_ns`, to `end_rad`, `duration_ns` later.

    The duration is the control period, so that a joint arrives when the next action is due; without one it
    stays there.
    """

    start_ns: int
    duration_ns: int
    begin_rad: Float64
    end_rad: Float64

    @classmethod
    def still(cls, now_ns: int, position_rad: Float64) -> Self:
        """Stay at `position_rad`."""
        return cls(now_ns, 1, position_rad, position_rad)

    def at(self, now_ns: int) -> Float64:
        """Set point (A,) rad at `now_ns`; before the start the beginning, after the end the end."""
        share = min(max((now_ns - self.start_ns) / self.duration_ns, 0.0), 1.0)
        # Weighted so that both ends are met exactly, and that NaN in an end never reaches past this ramp.
        return self.begin_rad if share == 0.0 else (1.0 - share) * self.begin_rad + share * self.end_rad

    def towards(self, now_ns: int, target_rad: Float64, duration_ns: int) -> Self:
        """The next ramp: from where this one is now to `target_rad`, without a jump.

        A non-finite target stays so, for the limits to refuse and count; it does not outlive its ramp.
        Raises ValueError unless the duration is positive.
        """
        if duration_ns <= 0:
            raise ValueError(f"duration_ns {duration_ns} is not positive")
        here = self.at(now_ns)
        begin = np.where(np.isfinite(here), here, self.begin_rad)
        return type(self)(now_ns, duration_ns, begin, target_rad)

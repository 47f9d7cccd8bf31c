"""A gate on a bench: short ways to ask it for something."""

from __future__ import annotations

from typing import Any

import numpy as np

from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import HIGH_RAD, MOTORS
from services.hand_io.limits_config import LimitsConfig

TICK_NS = 20_000_000  # 50 Hz
MIDDLE = HIGH_RAD / 2
MIDDLE[3] = 0.05  # of the spread, little enough for any curl
COOL_C = 30.0


def angles(*changes: tuple[int, float], base: Any = MIDDLE) -> Any:
    """Positions (12,) rad: `base` with some motors elsewhere."""
    result = np.array(base, np.float64)
    for motor, value in changes:
        result[motor] = value
    return result


class Bench:
    """A gate of the module `limits` (or of a mutant of it), a clock, and what the hand reports."""

    def __init__(self, limits: Any, angle_rad: Any = MIDDLE, **options: Any) -> None:
        self.limits = limits
        self.config = LimitsConfig(**{"max_current": 200, **options})
        self.gate = limits.Gate(self.config, DexHandConfig())
        self.now_ns = 10**18
        self.angle_rad = np.array(angle_rad, np.float64)
        self.temperature_c = np.full(6, COOL_C)
        self.flagged = np.zeros(MOTORS, np.bool_)
        self.lost = np.zeros(MOTORS, np.bool_)

    def ask(self, position_rad: Any, current: Any = 20, after_ns: int = TICK_NS) -> Any:
        """Let `after_ns` pass and ask for `position_rad`."""
        self.now_ns += after_ns
        currents = np.full(MOTORS, current, np.int64) if np.isscalar(current) else current
        request = self.limits.Request(np.asarray(position_rad, np.float64), currents)
        sensed = self.limits.Sensed(self.angle_rad, self.temperature_c, self.flagged, self.lost)
        return self.gate.step(self.now_ns, request, sensed)

    def count(self, reason: str) -> int:
        """Interventions so far."""
        return self.gate.counts[reason]

    def interventions(self) -> dict[str, int]:
        """All counts that are not zero."""
        return {str(reason): count for reason, count in self.gate.counts.items() if count}

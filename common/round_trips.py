"""How long plans take on the plant's own clock: no clock of another machine is needed."""

from __future__ import annotations

import numpy as np

ROUND_TRIPS = 16_384  # plans that the reported delays are taken over


class RoundTrips:
    """How long plans took on the plant's own clock, from the step that they start from to their arrival."""

    def __init__(self) -> None:
        self._ms = np.zeros((2, ROUND_TRIPS), np.float32)  # (age and overhead, newest plans)
        self._count = 0

    def add(self, age_ms: float, solve_ms: float) -> None:
        """Note one plan; its overhead is what was not solving: encoding, transport, waiting."""
        self._ms[:, self._count % ROUND_TRIPS] = age_ms, age_ms - solve_ms
        self._count += 1

    def fields(self) -> dict[str, float]:
        """Quantiles in ms, for the heartbeat; none before the first plan."""
        if not self._count:
            return {}
        ordered = np.sort(self._ms[:, : self._count], axis=1)  # a tenth of what np.percentile takes
        ranks = {"p50": 0.5, "p99": 0.99, "max": 1.0}
        return {
            f"{what}_ms_{name}": float(row[round(rank * (len(row) - 1))])
            for what, row in zip(("plan_age", "overhead"), ordered, strict=True)
            for name, rank in ranks.items()
        }

"""How well a frame fits a pose, whichever backend it came from."""

from __future__ import annotations

import numpy as np

from services.perception.backend import Quality
from services.perception.cpu.samples import Samples

CONSISTENT_M, VIOLATED_M = 0.008, 0.012
NOTHING = Quality(0.0, 0.0, 0.0, 0.0)


def judge(samples: Samples, left: float, total: float) -> Quality:
    """Quality at samples; the pose's own labelling leaves so much of a total of brightness unexplained."""
    if not len(samples.points):
        return NOTHING
    behind = samples.behind
    return Quality(
        consistent=float(np.mean(np.abs(behind) < CONSISTENT_M)),
        occluded=float(np.mean(behind < -CONSISTENT_M)),
        violated=float(np.mean(behind > VIOLATED_M)),
        pip_ncc=float(np.sqrt(max(0.0, 1 - left / total))) if total > 0 else 0.0,
    )

"""Settings of the simulated plant."""

from __future__ import annotations

from typing import Literal

from pydantic import NonNegativeInt

from common.config import Frozen

SimTask = Literal["reach", "egg", "egg_rotate", "block"]


class SimConfig(Frozen):
    """Which simulated hand and task to run; physics, substeps and start poses are the environment's own."""

    task: SimTask = "reach"
    seed: NonNegativeInt = 0  # of the episode that the plant is in before the first reset

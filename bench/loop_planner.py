"""The planner of `bench.loop`: everything as in production, but a plan always takes the same time.

`python -m bench.loop_planner --config FILE`; letters: H horizon, A action, S state.
"""

from __future__ import annotations

import time

import numpy as np
from pydantic import Field

from common.built import Built
from common.process import run_process
from common.task import Task, get_task
from services.planner.build import PlannerProcess
from services.planner.config import PlannerConfig
from services.planner.service import PlannerService
from services.planner.solver import Prepared, Request, Solution, Solver


class LoopPlannerProcess(PlannerProcess):
    """What this process is started with."""

    solve_ms: float = Field(default=10.0, gt=0, description="how long each plan takes")


class FixedTimeSolver(Solver):
    """Prepares snapshots as the real one does, and instead of planning sleeps."""

    def __init__(self, config: PlannerConfig, task: Task, seed: int, solve_ms: float) -> None:
        super().__init__(config, task, seed)
        self._solve_s = solve_ms / 1e3
        self._actions = np.zeros((config.horizon, task.action_dim), np.float32)

    def solve(self, request: Request, prepared: Prepared) -> Solution:
        """Return H zero actions after the given time."""
        time.sleep(self._solve_s)
        return Solution(
            request=request,
            actions=self._actions,
            predicted_k=request.first_k,
            predicted_state=request.state,
            predicted_std=np.zeros_like(request.state),
            score=0.0,
            valid=True,
            snapshot_id=prepared.snapshot_id,
        )


def build(config: LoopPlannerProcess, boot_id: int) -> Built:
    """Make the production service with the solver above."""
    task = get_task(config.task)
    solver = FixedTimeSolver(config.planner, task, config.seed, config.solve_ms)
    return Built(PlannerService(config, config.planner, task, solver, boot_id))


if __name__ == "__main__":
    run_process("planner", LoopPlannerProcess, build)

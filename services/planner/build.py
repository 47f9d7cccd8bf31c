"""Puts the planner together from its configuration."""

from __future__ import annotations

from common.built import Built
from common.cell import SharedConfig
from common.task import get_task
from services.planner.config import PlannerConfig
from services.planner.service import PlannerService
from services.planner.solver import Solver


class PlannerProcess(SharedConfig):
    """What the planner process is started with."""

    planner: PlannerConfig = PlannerConfig()


def build(config: PlannerProcess, boot_id: int) -> Built:
    """Make the service and the solver that it gives its work to."""
    task = get_task(config.task)
    solver = Solver(config.planner, task, config.seed)
    return Built(PlannerService(config, config.planner, task, solver, boot_id))

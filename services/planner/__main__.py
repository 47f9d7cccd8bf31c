"""`python -m services.planner --config FILE`: the planner as a process."""

from common.process import run_process
from services.planner.build import PlannerProcess, build

if __name__ == "__main__":
    run_process("planner", PlannerProcess, build)

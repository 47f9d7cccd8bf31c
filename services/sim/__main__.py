"""`python -m services.sim --config FILE`: the simulated hand as a process."""

from common.process import run_process
from services.sim.build import SimProcess, build_live

if __name__ == "__main__":
    run_process("sim", SimProcess, build_live)

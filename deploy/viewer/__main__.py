"""`python -m deploy.viewer --config FILE`: the live dashboard as a process."""

from common.process import run_process
from deploy.viewer.build import ViewerProcess, build

if __name__ == "__main__":
    run_process("viewer", ViewerProcess, build, nice=10)

"""`python -m services.hand_io --config FILE`: the real hand, or one emulated on its bus, as a process."""

from common.process import run_process
from services.hand_io.build import build
from services.hand_io.config import HandIoProcess

if __name__ == "__main__":
    run_process("hand_io", HandIoProcess, build)

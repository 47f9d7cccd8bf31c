"""`python -m services.perception --config FILE`: finds the die in a camera's pictures, as a process."""

from common.process import run_process
from services.perception.build import build
from services.perception.config import PerceptionProcess

if __name__ == "__main__":
    run_process("perception", PerceptionProcess, build)

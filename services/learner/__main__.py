"""`python -m services.learner --config FILE`: the learner as a process."""

from common.process import run_process
from services.learner.build import LearnerProcess, build

if __name__ == "__main__":
    run_process("learner", LearnerProcess, build, nice=5)

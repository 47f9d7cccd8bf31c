"""The learner's service with a real worker, stepped by hand; everything about it is tiny."""

from collections import deque
from dataclasses import replace

import numpy as np

from common.messages import Mode
from common.model.config import ModelConfig
from common.runner import run_job
from common.service import Publish
from common.topics import STEP
from services.learner.config import LearnerConfig, LossConfig
from services.learner.dataset import EpisodeStore
from services.learner.service import RETRY_NS, LearnerService
from services.learner.trainer import Trainer
from services.learner.worker import LearnerWorker
from tests.samples import PLANT, TASK, A, Driver, S, jobs, published, step

LENGTH = 5
MODEL = ModelConfig(members=1, hidden=(4,), train_masks=1, plan_masks=1)
CONFIG = LearnerConfig(
    loss=LossConfig(decay=(0.0, 0.0)),
    batch=4,
    warmup_updates=3,
    updates_per_episode=5,
    slice_updates=2,
    declared_update_ms=10,
    declared_store_ms=4,
)


class Learner(Driver):
    """The service with its worker, which runs one job when it is told to."""

    def __init__(self, directory, warmup_steps=2 * LENGTH, holdout=0.0):
        (directory / "learner").mkdir(parents=True, exist_ok=True)
        store = EpisodeStore(directory / "learner" / "episodes", S, A, holdout)
        self.worker = LearnerWorker(directory / "learner", store, Trainer(CONFIG, MODEL, TASK, 0))
        super().__init__(LearnerService(CONFIG, warmup_steps, self.worker, 33))
        self.directory = directory
        self.queue, self.sent, self.job_names = deque(), [], []
        self.turn()

    def turn(self):
        outputs = self.step()
        self.queue.extend(jobs(outputs))
        self.job_names += [job.name for job in jobs(outputs)]
        self.sent += [output for output in outputs if isinstance(output, Publish)]
        return outputs

    def record(self, number, mode=Mode.RANDOM, boot=PLANT, length=LENGTH):
        """Let the plant run a whole episode of random states."""
        draw = np.random.default_rng((number, boot))
        for k in range(length + 1):
            message = step(k, episode=number, steps=length, last=k == length, mode=mode)
            state = draw.uniform(-0.5, 0.5, S).astype(np.float32)
            action = draw.uniform(-1, 1, A).astype(np.float32)
            self.send(STEP, replace(message, state=state, prev_action=action), boot)
        self.turn()

    def work(self, duration_ns=0):
        """Finish the oldest job; returns what the service then publishes."""
        job = self.queue.popleft()
        self.finish(job, *run_job(job), duration_ns=duration_ns)
        return [o for o in self.turn() if isinstance(o, Publish)]

    def work_all(self):
        while self.queue:
            self.work()

    def wait(self, duration_ns=RETRY_NS):
        """Let time pass; the service is then called at a tick."""
        self.now_ns += duration_ns
        self.turn()

    def all(self, topic):
        return published(self.sent, topic)

    def files(self):
        return len(list((self.directory / "learner" / "episodes").glob("*.safetensors")))

    @property
    def fields(self):
        return self.service.report().fields

    @property
    def state(self):
        return self.service.report().state


def trained(learner):
    """Bring a learner to the end of its first update."""
    learner.record(0)
    learner.record(1)
    learner.work_all()
    return learner


def restart(learner):
    return Learner(learner.directory)

"""The plant's and the planner's service, each with what a runner and its devices would be to it."""

from collections import deque

import numpy as np

from common.cell import ControlConfig, SharedConfig
from common.runner import run_job
from common.service import Publish
from common.topics import CHUNK, EPISODE, PLANT_FRAME, SNAPSHOT, STEP
from services.planner.config import PlannerConfig
from services.planner.service import PlannerService
from services.planner.solver import Prepared, Solution
from services.sim.service import SimService
from tests.samples import (
    LEARNER,
    PLANNER,
    PLANT,
    TASK,
    A,
    Driver,
    S,
    chunk,
    command,
    episode,
    frame,
    jobs,
    published,
    snapshot,
)

H = 5


class Plant(Driver):
    """The service with a device that answers each command at once; frame n has the state n / 100."""

    def __init__(self, **control):
        config = SharedConfig(control=ControlConfig(steps_per_plan=2, **control))
        super().__init__(SimService(config, TASK, PLANT))
        self.answers = True
        self.steps, self.commands = [], []

    def turn(self, ticks=0):
        """One step of the service; returns what it published."""
        outputs = self.step(ticks)
        sent = published(outputs, STEP)
        self.steps += sent
        for each in command(outputs):
            self.commands.append(each)
            if self.answers:
                self.send(PLANT_FRAME, frame(len(self.commands) / 100, reset=each.reset))
        return sent

    def begin(self, **changes):
        """Bring an episode to the point where the plant waits for a plan, or moves."""
        self.send(EPISODE, episode(**changes))
        self.turn()
        return self.turn()

    def plan(self, first_k=0, values=(0.5,) * 5, boot=PLANNER, **changes):
        self.send(CHUNK, chunk(first_k, values, **changes), boot=boot)

    @property
    def fields(self):
        return self.service.report().fields


class TinySolver:
    """Plan n for step k: actions n/16 + i/128, whatever the state is."""

    def __init__(self):
        self.plans = 0
        self.fails = False

    def prepare(self, payload):
        if payload == b"broken":
            raise ValueError("not a snapshot")
        return Prepared(payload.decode(), None, None)

    def solve(self, request, prepared):
        if self.fails:
            raise RuntimeError("no luck")
        self.plans += 1
        ramp = self.plans / 16 + np.arange(H, dtype=np.float32)[:, None] / 128
        actions = np.repeat(ramp, A, axis=1).astype(np.float32)
        zeros = np.zeros(S, np.float32)
        k = request.first_k + request.commit
        valid = self.plans != 4
        score = -float(self.plans) if valid else -np.inf
        return Solution(request, actions, k, zeros, zeros, score, valid, prepared.snapshot_id)


class Planner(Driver):
    """The service with a worker that runs a job when it is told to; `requests` are the plans it was asked."""

    def __init__(self, planner=None, model=True, **control):
        self.solver = TinySolver()
        config = SharedConfig(control=ControlConfig(**({"steps_per_plan": 2} | control)))
        planner = planner or PlannerConfig(declared_solve_ms=50.0)
        super().__init__(PlannerService(config, planner, TASK, self.solver, 22))
        self.queue, self.requests, self.chunks, self.valid = deque(), [], [], []
        if model:
            self.show(SNAPSHOT, snapshot(b"first"), LEARNER)
            self.work("load")

    def turn(self, ticks=0):
        """One step, `ticks` of 40 ms after the last; returns the chunks that were sent."""
        outputs = self.step(ticks)
        self.valid += [o.valid for o in outputs if isinstance(o, Publish) and o.topic is CHUNK]
        for job in jobs(outputs):
            self.queue.append(job)
            self.requests += job.arguments[:1] if job.name == "plan" else ()
        sent = published(outputs, CHUNK)
        self.chunks += sent
        return sent

    def show(self, topic, message, boot=PLANT, **header):
        self.send(topic, message, boot, **header)
        return self.turn()

    def work(self, name="plan", milliseconds=10):
        """Finish the oldest job of that name; returns the chunks that this leads to."""
        job = next(job for job in self.queue if job.name == name)
        self.queue.remove(job)
        self.finish(job, *run_job(job), duration_ns=milliseconds * 1_000_000)
        return self.turn()

    @property
    def fields(self):
        return self.service.report().fields

    @property
    def state(self):
        return self.service.report().state

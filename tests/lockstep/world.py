"""Sim, planner and learner in lock-step with a scripted operator: everything tiny, the plant real."""

from pathlib import Path

import numpy as np
import yaml

from common.built import codec_for
from common.bus import Input, LocalBus
from common.buslog import BusLog, log_files, read_log
from common.clock import VirtualClock
from common.lockstep import Lockstep
from common.messages import Episode, Mode, Warmup
from common.runner import Dispatcher
from common.service import Finish, Publish, Report
from common.topics import EPISODE, METRICS, STEP
from services.learner.build import LearnerProcess
from services.learner.build import build as build_learner
from services.planner.build import PlannerProcess
from services.planner.build import build as build_planner
from services.sim.build import SimProcess
from services.sim.build import build as build_sim

SECOND = 1_000_000_000
CODEC = codec_for("reach")
BOOTS = {"sim": 11, "planner": 22, "learner": 33, "operator": 44}
PROCESSES = {
    "sim": (SimProcess, build_sim),
    "planner": (PlannerProcess, build_planner),
    "learner": (LearnerProcess, build_learner),
}
MODEL = {"members": 2, "hidden": [32, 32], "train_masks": 2, "plan_masks": 2, "targets": "standardised"}
SECTIONS = {
    "sim": {},
    "planner": {
        "planner": {
            "members": 2,
            "masks": 1,
            "horizon": 5,
            "candidates": 8,
            "elites": 3,
            "iterations": 2,
            "declared_solve_ms": 50.0,
        }
    },
    "learner": {
        "model": MODEL,
        "learner": {
            "loss": {"decay": [0.0, 0.0, 0.0], "variance_penalty": 0.5, "penalty_units": "standardised"},
            "batch": 16,
            "warmup_updates": 7,
            "updates_per_episode": 4,
            "slice_updates": 3,
            "declared_update_ms": 10.0,
        },
    },
}
SCRIPT = (
    (Mode.RANDOM, 20),
    (Mode.RANDOM, 20),
    (Mode.PLAN, 10),
    (Mode.PLAN, 10),
    (Mode.EVALUATE, 10),
)


class Operator:
    """Runs the script: each episode after the one before, the first planned one after the first update."""

    name = "operator"
    inputs = (Input(STEP, wake=True), Input(METRICS, newest=True, wake=True))
    period_ns = None
    boot_id = BOOTS["operator"]

    def __init__(self, script):
        self.script = script
        self.next = 0
        self.busy = False

    def step(self, now_ns, inbox):
        self.busy &= not any(s.message.last for s in inbox.take(STEP) if s.message.episode == self.next - 1)
        if self.busy:
            return []
        if self.next == len(self.script):
            return [Finish()]
        mode, steps = self.script[self.next]
        if mode is not Mode.RANDOM and inbox.newest(METRICS) is None:
            return []
        self.next, self.busy = self.next + 1, True
        goal = np.zeros(0, np.float32)
        message = Episode(self.next - 1, 0, goal, mode, Warmup.UNIFORM, steps, 1000 + self.next)
        return [Publish(EPISODE, message)]

    def stop(self, now_ns):
        return []

    def report(self):
        return Report("operating")


class World:
    """One run in `run_dir`, laid out like that of processes: config/<name>.yaml and log/*.buslog."""

    def __init__(self, run_dir: Path, script=SCRIPT, others=(), **control):
        self.run_dir = run_dir
        self.bus = LocalBus()
        (run_dir / "config").mkdir(parents=True)
        services = {"operator": (Operator(script), {})}
        for name, (model, build) in PROCESSES.items():
            built = build(self._config(name, model, control), BOOTS[name])
            services[name] = (built.service, built.ports)
        self.dispatchers = {
            name: Dispatcher(service, CODEC, self.bus, ports, self._log(name))
            for name, (service, ports) in services.items()
        }
        for service in others:
            self.dispatchers[service.name] = Dispatcher(service, CODEC, self.bus, {})
        self.clock = VirtualClock()
        self.lockstep = Lockstep(list(self.dispatchers.values()), self.clock)

    def _config(self, name, model, control):
        shared = {"task": "reach", "seed": 0, "warmup_steps": 40, "run_dir": str(self.run_dir)}
        data = {**shared, "control": {"steps_per_plan": 2, **control}, **SECTIONS[name]}
        path = self.run_dir / "config" / f"{name}.yaml"
        path.write_text(yaml.safe_dump(data), encoding="utf-8")
        return model.model_validate(data)

    def _log(self, name):
        return BusLog(self.run_dir / "log", name, BOOTS[name], 10**8, 10**9)

    def run(self, each_instant=lambda: None):
        """Run the script to its end, calling `each_instant` before every instant."""

        def until():
            each_instant()
            return False

        assert self.lockstep.run(until, 600 * SECOND), "the script did not end"
        self.lockstep.close()
        return self

    def fields(self, name):
        return self.dispatchers[name].service.report().fields

    def sent(self, name, topic):
        """What a service sent on a topic, decoded."""
        frames = [e for e in entries(self.run_dir, name) if e.kind == "out" and e.key == topic.key]
        return [CODEC.decode(entry.key, entry.payload) for entry in frames]


def entries(run_dir, name):
    return [entry for path in log_files(run_dir / "log", name) for entry in read_log(path)]


def logs(run_dir):
    """The bytes of every log, by file name."""
    return {path.name: path.read_bytes() for path in log_files(run_dir / "log")}

"""What the control loop costs beside planning: `python -m bench.loop` prints one JSON object.

The processes are those of a live cell, over its bus and on the wall clock. Only the plan itself is replaced,
by a fixed time, and the learner's snapshots by one of 15 MB sent twice a second. overhead = from the plant's
publishing of a state to the arrival of the plan made from it, less the time of solving; on the plant's clock.
A second run has a learner training beside the loop.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import yaml

from bench.loop_learner import fill_store
from bench.loop_planner import LoopPlannerProcess
from bench.loop_snapshots import SnapshotsProcess
from bench.provenance import provenance
from common.built import codec_for, new_boot_id
from common.bus_config import BusConfig
from common.cell import ControlConfig, LogConfig, SharedConfig
from common.messages import Episode, Header, Health, Mode, Warmup
from common.model.config import ModelConfig
from common.plant_loop import Phase
from common.topics import EPISODE, HEALTH
from common.zenoh_bus import ZenohBus
from common.zenoh_router import BusError
from services.learner.build import LearnerProcess
from services.learner.config import LearnerConfig
from services.planner.config import PlannerConfig
from services.sim.build import SimProcess

ROOT = Path(__file__).parents[1]
START_S = 120.0  # for all processes together to come up, on a busy laptop
STOP_S = 5.0
SNAPSHOT_MEMBERS = 6  # of the paper's size, 2.5 MB each: 15 MB a snapshot; the planner uses 5
TRAINING_EPISODES = 20
ENDLESS = 1_000_000_000  # gradient steps
EVALUATION_SEED = 1_000_000
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class LoopError(Exception):
    """The measurement cannot be made; the message is one line."""


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    task: str = "reach"
    steps: int = 10_000
    rate_hz: float = 25.0
    x: int = 2
    solve_ms: float = 10.0
    snapshot_hz: float = 2.0


class Cell:
    """The processes of one run, from entry to exit of the `with` block; nothing of them is left behind."""

    def __init__(self, settings: Settings, learner: bool) -> None:
        self._settings = settings
        self._learner = learner
        self._directory = tempfile.TemporaryDirectory(prefix="gc-pmpc-loop-")
        self._run_dir = Path(self._directory.name)
        self._endpoint = _free_endpoint()
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._health: dict[str, Health] = {}
        self._codec = codec_for(settings.task)
        self._bus: ZenohBus | None = None

    def __enter__(self) -> Cell:
        """Start everything; wait until the planner has a model and the learner trains. Raises LoopError."""
        try:
            self._start()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop everything."""
        self._stop()

    def _start(self) -> None:
        if self._learner:
            fill_store(self._run_dir / "learner" / "episodes", self._settings.task, TRAINING_EPISODES)
        self._spawn("router", "deploy.router", "--listen", self._endpoint)
        for name, (module, config) in self._processes().items():
            path = self._run_dir / f"{name}.yaml"
            path.write_text(yaml.safe_dump(config.model_dump(mode="json")), encoding="utf-8")
            self._spawn(name, module, "--config", str(path))
        self._wait(START_S, "to come up", self._ready)

    def _processes(self) -> dict[str, tuple[str, SharedConfig]]:
        settings, shared = self._settings, self._shared()
        planner = PlannerConfig.model_validate({"preset": "fast"})
        model = ModelConfig(members=SNAPSHOT_MEMBERS)
        configs: dict[str, tuple[str, SharedConfig]] = {
            "sim": ("services.sim", SimProcess(**shared)),
            "planner": (
                "bench.loop_planner",
                LoopPlannerProcess(**shared, planner=planner, solve_ms=settings.solve_ms),
            ),
            "snapshots": (
                "bench.loop_snapshots",
                SnapshotsProcess(**shared, model=model, snapshot_hz=settings.snapshot_hz),
            ),
        }
        if self._learner:
            learner = LearnerProcess(**shared, learner=LearnerConfig(warmup_updates=ENDLESS))
            configs["learner"] = ("services.learner", learner)
        return configs

    def _shared(self) -> dict[str, Any]:
        settings = self._settings
        return {
            "task": settings.task,
            "warmup_steps": 1,  # what is stored suffices: the learner begins at once
            "run_dir": self._run_dir,
            "bus": BusConfig(connect=(self._endpoint,), connect_timeout_s=START_S),
            "control": ControlConfig(rate_hz=settings.rate_hz, steps_per_plan=settings.x),
            "log": LogConfig(segment_mb=32, keep_mb=128),
        }

    def _spawn(self, name: str, module: str, *arguments: str) -> None:
        with (self._run_dir / f"{name}.err").open("wb") as err:
            self._children[name] = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=ROOT,
                env=os.environ | ONE_THREAD,
                stdout=subprocess.DEVNULL,
                stderr=err,
            )

    def _take_health(self, key: str, payload: bytes) -> None:
        health: Health = self._codec.decode(key, payload).message
        self._health[health.service] = health

    def field(self, service: str, name: str) -> float:
        """Return what a service last reported; 0 before it has."""
        health = self._health.get(service)
        return health.fields.get(name, 0.0) if health else 0.0

    def health(self, service: str) -> Health:
        """Return the last heartbeat of a service."""
        return self._health[service]

    def _connected(self) -> bool:
        """Join the bus if it is there; a short try, for the router may have failed."""
        if self._bus is None:
            config = BusConfig(connect=(self._endpoint,), connect_timeout_s=1.0)
            try:
                self._bus = ZenohBus(config, SharedConfig().cell, "bench")
            except BusError:
                return False
            self._bus.subscribe(HEALTH, self._take_health)
        return True

    def _ready(self) -> bool:
        if not self._connected():
            return False
        trains = not self._learner or self.field("learner", "updates") > 0
        return trains and "sim" in self._health and self.field("planner", "snapshots") > 0

    def run_episode(self) -> float:
        """Run one evaluation episode of all the steps; returns its duration in s. Raises LoopError."""
        assert self._bus is not None
        steps, begun = self._settings.steps, time.monotonic()
        empty = np.zeros(0, np.float32)
        episode = Episode(1, 0, empty, Mode.EVALUATE, Warmup.NONE, steps, EVALUATION_SEED)
        header = Header(new_boot_id(), 0, time.time_ns(), True)
        self._bus.publish(EPISODE, EPISODE.key, self._codec.encode(header, episode))
        limit_s = 1.5 * steps / self._settings.rate_hz + START_S
        self._wait(limit_s, "to finish the episode", lambda: self._health["sim"].state == Phase.DONE.value)
        return time.monotonic() - begun

    def _wait(self, limit_s: float, what: str, reached: Callable[[], bool]) -> None:
        deadline = time.monotonic() + limit_s
        while not reached():
            for name, child in self._children.items():
                if child.poll() is not None:
                    raise LoopError(f"{name} ended with code {child.returncode}: {self._last_line(name)}")
            if time.monotonic() > deadline:
                states = "; ".join(f"{name}: {health.state}" for name, health in self._health.items())
                raise LoopError(f"waited {limit_s:.0f} s in vain for the processes {what} ({states})")
            time.sleep(0.1)

    def _last_line(self, name: str) -> str:
        lines = (self._run_dir / f"{name}.err").read_text(errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "it said nothing")

    def _stop(self) -> None:
        if self._bus is not None:
            self._bus.close()
        for child in reversed(self._children.values()):
            child.terminate()
        deadline = time.monotonic() + STOP_S
        for child in self._children.values():
            try:
                child.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        self._directory.cleanup()


def measure(settings: Settings, learner: bool) -> dict[str, Any]:
    """Run the loop once, a learner beside it or not. Raises LoopError."""
    with Cell(settings, learner) as cell:
        before = {name: cell.field(*name) for name in (("planner", "snapshots"), ("learner", "updates"))}
        seconds = cell.run_episode()
        rates = {name: (cell.field(*name) - count) / seconds for name, count in before.items()}
        return _summary(cell, rates, learner)


def _summary(cell: Cell, rates: Mapping[tuple[str, str], float], learner: bool) -> dict[str, Any]:
    def rounded(service: str, *names: str) -> dict[str, float]:
        values = {name: round(cell.field(service, name), 3) for name in names}
        return {name: int(value) if value.is_integer() else value for name, value in values.items()}

    megabytes = rates["planner", "snapshots"] * cell.field("snapshots", "snapshot_mb")
    trained = {"updates_per_s": round(rates["learner", "updates"], 2)} if learner else {}
    names = ("sim", "planner", "snapshots", *(("learner",) if learner else ()))
    delays = [f"{what}_ms_{q}" for what in ("overhead", "plan_age") for q in ("p50", "p99", "max")]
    return {
        **rounded("sim", *delays, "missed_ticks", "late_steps", "held_steps", "refused_chunks"),
        "steps": round(cell.field("sim", "control_steps")),
        **rounded("planner", "plans", "plan_ms_p50", "plan_ms_p99", "plan_wait_ms_max"),
        "snapshots_loaded_mb_per_s": round(megabytes, 2),
        **trained,
        "loop_ms_p50_p99": {
            name: [round(cell.health(name).loop_p50_ms, 3), round(cell.health(name).loop_p99_ms, 3)]
            for name in names
        },
        "rss_mb": {name: round(cell.health(name).rss_mb) for name in names},
    }


def _free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 0, or 2 after one line about what is wrong."""
    given = vars(_parser().parse_args(arguments))
    as_json, learner = given.pop("json"), given.pop("learner")
    settings = Settings(**given)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        result = measure(settings, learner=False)
        if learner:
            result["with_learner"] = measure(settings, learner=True)
    except LoopError as error:
        print(f"bench.loop: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    result |= {"settings": asdict(settings), **provenance()}
    print(json.dumps(result, indent=None if as_json else 2))
    return 0


def _parser() -> argparse.ArgumentParser:
    default = Settings()
    parser = argparse.ArgumentParser(prog="python -m bench.loop", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--task", default=default.task)
    parser.add_argument("--steps", type=int, default=default.steps, help="of the control loop")
    parser.add_argument("--rate", dest="rate_hz", type=float, default=default.rate_hz, help="Hz")
    parser.add_argument("--x", type=int, default=default.x, help="actions per plan")
    parser.add_argument("--solve-ms", type=float, default=default.solve_ms, help="fixed time of a plan")
    parser.add_argument("--snapshot-hz", type=float, default=default.snapshot_hz)
    parser.add_argument("--learner", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--json", action="store_true", help="on one line")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""A small live cell: started by the real entry points, heard on its bus, and dead at the end of its tests."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from common.built import codec_for
from common.bus_config import BusConfig
from common.codec import Refused
from common.messages import Health, Mode, Sample, Step
from common.topics import ACK, CHUNK, EPISODE, HEALTH, METRICS, STEP, Topic
from common.zenoh_bus import ZenohBus
from deploy.supervisor import REPOSITORY, RunFiles
from deploy.supervisor_client import ProcessInfo, SupervisorClient

PATIENCE_S = 90.0  # only what never happens must fail, however slow the machine
END_S = 10.0  # what DESIGN grants to any end
STEPS = 50
HEARD = (STEP, CHUNK, EPISODE, ACK, METRICS, HEALTH)

# Tiny, and never finished by itself: one evaluation, then training goals.
SIZES = (
    "warmup_steps=200",
    "model.members=2",
    "model.hidden=[32, 32]",
    "model.targets=standardised",
    "planner.members=2",
    "planner.candidates=16",
    "planner.elites=4",
    "planner.refine_steps=2",
    "learner.warmup_updates=60",
    "learner.updates_per_episode=10",
    "learner.loss.decay=[0.5e-4, 1.25e-4, 2.5e-4]",
    f"curriculum.episode_steps={STEPS}",
    "curriculum.evaluate_goals=1",
    "curriculum.evaluate_every=10000",
    "curriculum.episodes=10000",
)


def wait(condition: Callable[[], Any], what: str | Callable[[], str], patience_s: float = PATIENCE_S) -> Any:
    """Poll until the condition gives something true, and return that."""
    deadline = time.monotonic() + patience_s
    while not (found := condition()):
        if time.monotonic() > deadline:
            pytest.fail(f"waited in vain for {what if isinstance(what, str) else what()}")
        time.sleep(0.02)
    return found


def free_ports(count: int) -> list[int]:
    """TCP ports that nobody uses now."""
    with contextlib.ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


class Ear:
    """Everything small that is said on a cell's bus, decoded, in order of arrival and without repetitions."""

    def __init__(self, port: int, cell: str, task: str = "reach", heard: tuple[Topic, ...] = HEARD) -> None:
        self._codec = codec_for(task)
        self._lock = threading.Lock()
        self._samples: dict[Topic, list[tuple[float, Sample]]] = defaultdict(list)
        self._known: set[tuple[str, int, int]] = set()
        patient = BusConfig(connect=(f"tcp/127.0.0.1:{port}",), connect_timeout_s=PATIENCE_S)
        self.bus = ZenohBus(patient, cell, "ear")
        for topic in heard:
            self.bus.subscribe(topic, lambda key, payload, topic=topic: self._hear(topic, key, payload))

    def _hear(self, topic: Topic, key: str, payload: bytes) -> None:
        try:
            sample = self._codec.decode(key, payload)
        except Refused:
            return
        identity = (key, sample.header.boot_id, sample.header.seq)
        with self._lock:
            if identity not in self._known:
                self._known.add(identity)
                self._samples[topic].append((time.monotonic(), sample))

    def samples(self, topic: Topic, since: float = 0.0) -> list[Sample]:
        """What arrived after the monotonic time `since`."""
        with self._lock:
            return [sample for at, sample in self._samples[topic] if at > since]

    def newest(self, topic: Topic) -> Sample | None:
        with self._lock:
            return self._samples[topic][-1][1] if self._samples[topic] else None

    def health(self, name: str, since: float = 0.0) -> Health | None:
        """The newest heartbeat of a process."""
        found = [s.message for s in self.samples(HEALTH, since) if s.message.service == name]
        return found[-1] if found else None

    def boot(self, name: str) -> int:
        """Boot id of the process that spoke last under this name."""
        found = [s.header.boot_id for s in self.samples(HEALTH) if s.message.service == name]
        return found[-1] if found else 0

    def field(self, name: str, field: str) -> float:
        health = self.health(name)
        return health.fields.get(field, 0.0) if health else 0.0

    def steps_of(self, episode: int) -> list[Sample]:
        """Steps of an episode that moved, by k."""
        found = [s for s in self.samples(STEP) if s.message.episode == episode and not s.message.waiting]
        return sorted(found, key=lambda sample: sample.message.k)

    def close(self) -> None:
        self.bus.close()


class LiveCell:
    """One machine's part of a cell, or all of it (`machine` empty), in a run directory of its own."""

    def __init__(
        self, run_dir: Path, ports: list[int], *, config: str = "debug", machine: str = "", sets: Any = ()
    ) -> None:
        self.run_dir = run_dir
        self.config = config
        self.port, grpc, web = ports
        endpoint = f"[tcp/127.0.0.1:{self.port}]"
        self._machine = machine
        self._sets = (
            *SIZES,
            f"run_dir={run_dir}",
            f"bus.listen={endpoint}",
            f"bus.connect={endpoint}",
            f"viewer.grpc_port={grpc}",
            f"viewer.web_port={web}",
            *sets,
        )
        self.supervisor = SupervisorClient(RunFiles(run_dir, machine or "local").socket)
        self.ear: Ear | None = None

    @property
    def sets(self) -> tuple[str, ...]:
        """The overrides of the cell file."""
        return self._sets

    def begin(self, command: str) -> subprocess.Popen[str]:
        """Start `deploy/run_all.sh [MACHINE] COMMAND` as its last line does."""
        words = [sys.executable, "-m", "deploy.main", *([self._machine] if self._machine else [])]
        options = [word for item in self._sets for word in ("--set", item)]
        return subprocess.Popen(
            [*words, "--config", self.config, *options, command],
            cwd=REPOSITORY,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def do(self, command: str, code: int = 0) -> str:
        """Carry a command out and return what it printed."""
        process = self.begin(command)
        try:
            out, _ = process.communicate(timeout=2 * PATIENCE_S)
        finally:
            process.kill()
        assert process.returncode == code, out
        return out

    def listen(self) -> Ear:
        """Join the bus, as soon as there is one."""
        self.ear = Ear(self.port, self.config)
        return self.ear

    def up(self) -> None:
        """Start in the background, listening from the first word on."""
        starting = self.begin("up")
        try:
            self.listen()
            out, _ = starting.communicate(timeout=2 * PATIENCE_S)
        finally:
            starting.kill()
        assert starting.returncode == 0, out

    @property
    def heard(self) -> Ear:
        assert self.ear is not None, "not listening"
        return self.ear

    def processes(self) -> dict[str, ProcessInfo]:
        return self.supervisor.processes()

    def pids(self) -> dict[str, int]:
        return {name: info.pid for name, info in self.processes().items()}

    def signal(self, name: str, number: int) -> float:
        """Send a signal to one service and return the monotonic time of it."""
        os.kill(self.pids()[name], number)
        return time.monotonic()

    def mid_episode(self) -> Step:
        """Wait for the middle of a training episode; the step that the plant is at."""

        def running() -> Step | None:
            sample = self.heard.newest(STEP)
            step = sample.message if sample else None
            fits = step and step.mode is Mode.PLAN and not step.waiting and 5 <= step.k <= 20
            return step if fits else None

        return wait(running, "the middle of an episode")

    def end(self) -> None:
        """Leave nothing behind, whatever has happened."""
        if self.ear is not None:
            self.ear.close()
            self.ear = None
        for pid in self.alive():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)  # a frozen one cannot even be seen to die
                os.kill(pid, signal.SIGKILL)
        wait(lambda: not self.alive(), "the end of every process")

    def alive(self) -> dict[int, str]:
        """Processes of this run: all of them name its folder on their command line."""
        found: dict[int, str] = {}
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = path.read_bytes().decode(errors="replace").split("\0")
                if any(str(self.run_dir) in word for word in words):
                    found[int(path.parent.name)] = " ".join(words)
        return found


def stored(run_dir: Path) -> set[tuple[int, int]]:
    """(plant's boot id, episode) of every episode that the learner has on disk."""
    names = [path.stem.split("-") for path in (run_dir / "learner" / "episodes").glob("[0-9]*.safetensors")]
    return {(int(boot, 16), int(episode)) for _, boot, episode in names}


def acknowledged(ear: Ear) -> set[tuple[int, int]]:
    return {(s.message.plant_boot_id, s.message.episode) for s in ear.samples(ACK)}

"""The bus when processes die, freeze, lag or come back; all bounds are generous, only hangs must fail."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from common.bus_config import BusConfig
from common.topics import SNAPSHOT, STEP
from common.zenoh_bus import ZenohBus

pytestmark = pytest.mark.processes

PATIENCE_S = 15.0
REPOSITORY = Path(__file__).parents[2]
PERIOD_S = 0.01


class Processes:
    """Children of one test, and the endpoint of its router."""

    def __init__(self) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        self.running: list[subprocess.Popen[str]] = []

    def start(self, module: str, *arguments: str) -> subprocess.Popen[str]:
        """Start a child and wait for its first line."""
        command = [sys.executable, "-m", module, *arguments]
        child = subprocess.Popen(
            command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.running.append(child)
        assert child.stdout is not None
        assert child.stdout.readline(), child.communicate()[1]
        return child

    def router(self) -> subprocess.Popen[str]:
        return self.start("deploy.router", "--listen", self.endpoint)

    def child(self, role: str, *arguments: object) -> subprocess.Popen[str]:
        return self.start("tests.processes.zenoh_child", role, self.endpoint, *map(str, arguments))

    def bus(self, name: str = "test") -> ZenohBus:
        return ZenohBus(BusConfig(connect=(self.endpoint,)), "cell", name)


@pytest.fixture
def processes() -> Iterator[Processes]:
    made = Processes()
    yield made
    for child in made.running:
        child.kill()
        child.communicate()


class Steps:
    """A sink for the payloads of `zenoh_child`: (boot, i) in order of arrival, without repetitions."""

    def __init__(self) -> None:
        self.seen: dict[tuple[int, int], float] = {}
        self.delays_s: list[float] = []

    def __call__(self, _key: str, payload: bytes) -> None:
        boot, i, sent_ns = map(int, payload.split()[:3])
        self.seen.setdefault((boot, i), time.monotonic())
        self.delays_s.append((time.time_ns() - sent_ns) / 1e9)

    def of(self, boot: int) -> list[int]:
        return [i for found, i in self.seen if found == boot]

    @property
    def longest_silence_s(self) -> float:
        return max(b - a for a, b in pairwise([*self.seen.values(), time.monotonic()]))


def wait(condition: Callable[[], bool]) -> float:
    """Wait until the condition holds and return how long it took, in s."""
    started = time.monotonic()
    while not condition():
        assert time.monotonic() - started < PATIENCE_S, "waited in vain"
        time.sleep(0.01)
    return time.monotonic() - started


def end(child: subprocess.Popen[str]) -> tuple[int, float]:
    """TERM a publisher and return how many payloads it published and its slowest call in ms."""
    child.send_signal(signal.SIGTERM)
    out, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0, err
    sent, worst_ms = out.split()
    return int(sent), float(worst_ms)


def test_nothing_is_lost_when_the_router_is_killed_and_comes_back(processes: Processes) -> None:
    router = processes.router()
    publisher = processes.child("steps", 1, PERIOD_S)
    bus, steps = processes.bus(), Steps()
    bus.subscribe(STEP, steps)
    wait(lambda: len(steps.seen) > 50)
    router.kill()
    router.wait()
    time.sleep(1.0)  # about 100 steps; the sender keeps 256
    before = len(steps.seen)
    processes.router()
    assert wait(lambda: len(steps.seen) > before + 150) < 1.5 + 3.0
    sent, worst_ms = end(publisher)
    wait(lambda: len(steps.seen) == sent)
    assert steps.of(1) == list(range(sent))
    assert bus.misses == {}
    assert worst_ms < 100
    bus.close()


def test_what_is_older_than_the_cache_is_counted_as_missed(processes: Processes) -> None:
    router = processes.router()
    publisher = processes.child("steps", 1, 0.001)
    bus, steps = processes.bus(), Steps()
    bus.subscribe(STEP, steps)
    wait(lambda: len(steps.seen) > 50)
    router.kill()
    router.wait()
    before = len(steps.seen)
    time.sleep(1.5)
    processes.router()
    wait(lambda: len(steps.seen) > before + 100)
    sent, _ = end(publisher)
    wait(lambda: (1, sent - 1) in steps.seen)
    assert steps.of(1) == sorted(steps.of(1))
    since_joined = sent - min(steps.of(1))  # what came before the first one heard is history, not a loss
    assert bus.misses.get(STEP.key, 0) == since_joined - len(steps.seen) > 0
    bus.close()


def test_a_publisher_that_starts_anew_is_heard_from_its_first_step(processes: Processes) -> None:
    processes.router()
    bus, steps = processes.bus(), Steps()
    bus.subscribe(STEP, steps)
    first = processes.child("steps", 1, PERIOD_S)
    wait(lambda: len(steps.of(1)) > 50)
    first.kill()
    first.wait()
    wait(lambda: "steps" not in bus.alive())
    processes.child("steps", 2, PERIOD_S)
    wait(lambda: len(steps.of(2)) > 50)
    assert steps.of(1) == list(range(len(steps.of(1))))
    assert steps.of(2) == list(range(len(steps.of(2))))
    bus.close()


def test_a_subscriber_that_starts_anew_gets_the_last_steps_and_goes_on(processes: Processes) -> None:
    processes.router()
    processes.child("steps", 1, 0.002)
    first, steps = processes.bus("learner"), Steps()
    first.subscribe(STEP, steps)
    wait(lambda: (1, 400) in steps.seen)
    first.close()
    second, again = processes.bus("learner"), Steps()
    second.subscribe(STEP, again)
    wait(lambda: len(again.seen) > STEP.latched + 100)
    numbers = again.of(1)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert numbers[0] <= max(steps.of(1)) + 1  # the time between them is covered by the history
    second.close()


def test_a_frozen_subscriber_stalls_nobody(processes: Processes) -> None:
    processes.router()
    frozen = processes.child("listen")
    snapshots = processes.child("snapshots", 0.5)
    publisher = processes.child("steps", 1, PERIOD_S)
    bus, steps, heard = processes.bus(), Steps(), Steps()
    bus.subscribe(STEP, steps)
    bus.subscribe(SNAPSHOT, heard)
    wait(lambda: len(heard.seen) >= 2 and len(steps.seen) > 50)
    frozen.send_signal(signal.SIGSTOP)
    time.sleep(5.0)  # longer than the lease
    assert steps.longest_silence_s < 1.0
    assert len(heard.seen) >= 6
    frozen.send_signal(signal.SIGCONT)
    time.sleep(1.0)
    assert steps.longest_silence_s < 1.0
    assert end(publisher)[1] < 100
    assert end(snapshots)[1] < 100
    bus.close()


def test_a_slow_reader_of_snapshots_does_not_delay_steps(processes: Processes) -> None:
    processes.router()
    processes.child("snapshots", 0.5)
    publisher = processes.child("steps", 1, PERIOD_S)
    bus, steps = processes.bus(), Steps()
    bus.subscribe(SNAPSHOT, lambda _key, _payload: time.sleep(0.8))
    bus.subscribe(STEP, steps)
    wait(lambda: len(steps.seen) > 100)
    steps.delays_s.clear()
    time.sleep(3.0)
    assert max(steps.delays_s) < 0.5
    assert end(publisher)[1] < 100
    bus.close()


@pytest.mark.parametrize("router_state", ["up", "killed", "frozen"])
def test_a_process_ends_soon_after_term_with_subscriptions_open(
    processes: Processes, router_state: str
) -> None:
    router = processes.router()
    child = processes.child("listen")
    if router_state == "killed":
        router.kill()
        router.wait()
    elif router_state == "frozen":
        router.send_signal(signal.SIGSTOP)
    child.send_signal(signal.SIGTERM)
    assert child.wait(timeout=10) == 0


def test_the_router_ends_at_term_and_complains_in_one_line(processes: Processes) -> None:
    router = processes.router()
    second = subprocess.run(
        [sys.executable, "-m", "deploy.router", "--listen", processes.endpoint],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert second.returncode == 2
    assert processes.endpoint in second.stderr
    assert second.stderr.count("\n") == 1
    router.send_signal(signal.SIGTERM)
    assert router.wait(timeout=5) == 0

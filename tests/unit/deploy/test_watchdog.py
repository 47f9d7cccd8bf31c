from dataclasses import dataclass, field

import pytest
from pydantic import ValidationError

from common.bus import Inbox, JobResult
from common.codec import Codec
from common.messages import Header, Health
from common.runner import run_job
from common.service import Job
from common.topics import HEALTH
from deploy.supervisor_client import ProcessInfo
from deploy.watchdog import Watchdog, is_frozen
from deploy.watchdog_config import WatchdogConfig

SECOND = 1_000_000_000


def running(name: str, uptime_s: float, state: str = "RUNNING") -> ProcessInfo:
    return ProcessInfo(name, state, 1, 0, uptime_s, "")


@dataclass
class FakeSupervisor:
    """supervisord as far as the watchdog sees it."""

    infos: dict[str, ProcessInfo] = field(default_factory=dict)
    restarted: list[str] = field(default_factory=list)

    def processes(self) -> dict[str, ProcessInfo]:
        return self.infos

    def restart(self, name: str, patience_s: float) -> None:
        assert patience_s > 0
        self.restarted.append(name)
        self.infos[name] = running(name, 0)


class Bench:
    """A watchdog, a supervisord whose processes stay as they are, and half-second steps."""

    def __init__(self, *watches: str, uptime_s: float = 300.0) -> None:
        self.supervisor = FakeSupervisor({name: running(name, uptime_s) for name in watches})
        self.watchdog = Watchdog(WatchdogConfig(watches=watches), self.supervisor, boot_id=1)
        self.codec = Codec({})
        self.inbox = Inbox(self.codec, self.watchdog.inputs)
        self.now_ns = 0
        self.seq = 0

    def run(self, seconds: float, *speakers: str) -> None:
        """Let `speakers` be heard at every step."""
        for _ in range(round(2 * seconds)):
            self.now_ns += SECOND // 2
            for name in speakers:
                self._hear(name)
            self.inbox.collect(self.now_ns, 1)
            for output in self.watchdog.step(self.now_ns, self.inbox):
                assert isinstance(output, Job)
                value, error = run_job(output)
                self.inbox.finish(JobResult(output.name, value, error, 0))

    def _hear(self, name: str) -> None:
        self.seq += 1
        health = Health(name, "", 0.0, 0.0, 0, 0, (), {}, {}, "", "", 0.0)
        payload = self.codec.encode(Header(2, self.seq, self.now_ns, True), health)
        self.inbox.sink(HEALTH)(f"health/{name}", payload)


def test_a_frozen_process_is_restarted_after_five_seconds() -> None:
    bench = Bench("router", "sim", "planner")
    bench.run(3, "sim", "planner")
    bench.run(5, "sim")
    assert bench.supervisor.restarted == []
    bench.run(1, "sim")
    assert bench.supervisor.restarted[0] == "planner"
    assert set(bench.supervisor.restarted) == {"planner"}
    assert bench.watchdog.report().fields["restarts_planner"] >= 1


def test_nobody_is_restarted_while_all_are_heard() -> None:
    bench = Bench("router", "sim", "planner")
    bench.run(60, "sim", "planner")
    assert bench.supervisor.restarted == []


def test_when_nobody_is_heard_the_router_is_to_blame() -> None:
    bench = Bench("router", "sim", "planner")
    bench.run(3, "sim", "planner")
    bench.run(7)
    assert set(bench.supervisor.restarted) == {"router"}
    bench.supervisor.restarted.clear()
    bench.run(1, "sim")
    bench.run(2, "sim", "planner")  # a moment later than sim: no reason to restart it
    assert bench.supervisor.restarted == []


def test_a_router_that_freezes_between_two_heartbeats_is_still_the_one_to_blame() -> None:
    bench = Bench("router", "sim", "planner")
    bench.run(10, "sim", "planner")
    bench.run(1, "planner")  # the sim's last heartbeats did not get through any more
    bench.run(10)
    assert bench.supervisor.restarted == ["router"]
    bench.run(3, "planner")  # and the first one to be heard again is no reason to blame the other
    assert bench.supervisor.restarted == ["router"]


def test_when_another_machines_router_is_gone_nobody_is_restarted() -> None:
    bench = Bench("planner", "learner")
    bench.run(3, "planner", "learner", "sim")
    bench.run(30)
    assert bench.supervisor.restarted == []


def test_own_heartbeat_and_own_sleep_prove_nothing() -> None:
    bench = Bench("sim", "planner")
    bench.run(3, "sim", "planner", "watchdog")
    bench.run(20, "watchdog")
    bench.now_ns += 60 * SECOND
    bench.run(4, "sim")
    assert bench.supervisor.restarted == []


@pytest.mark.parametrize(
    ("info", "silent_s", "frozen"),
    [
        (running("x", 300), 6.0, True),
        (running("x", 4), 6.0, False),  # has only just been started
        (running("x", 6), 5.5, False),  # and supervisord rounds
        (running("x", 61), float("inf"), True),  # should have spoken long ago
        (running("x", 59), float("inf"), False),
        (running("x", 300, "EXITED"), 6.0, False),  # finished, or supervisord's business
        (running("x", 300, "STOPPED"), 6.0, False),
        (running("x", 300, "BACKOFF"), 6.0, False),
    ],
)
def test_frozen_is_neither_gone_nor_still_starting(info: ProcessInfo, silent_s: float, frozen: bool) -> None:
    assert is_frozen(info, silent_s, start_deadline_s=60.0) is frozen


def test_all_silent_processes_get_their_turn() -> None:
    bench = Bench("sim", "planner", "learner", "curriculum")
    bench.supervisor.infos["curriculum"] = running(
        "curriculum", 300, "EXITED"
    )  # silent for good, and rightly
    bench.run(3, "sim", "planner", "learner", "curriculum")
    bench.run(8, "sim")
    assert bench.supervisor.restarted == ["planner", "learner"]


def test_hand_io_is_never_restarted() -> None:
    with pytest.raises(ValidationError, match="only people restart it"):
        WatchdogConfig(watches=("planner", "hand_io"))
    bench = Bench("planner")
    bench.supervisor.infos["hand_io"] = running("hand_io", 300)
    bench.run(3, "planner", "hand_io")
    bench.run(60, "planner")
    assert bench.supervisor.restarted == []

"""Lock-step runs depend on the services alone: declared latencies, a fixed order, one job at a time."""

import pytest

from common.bus import Input, LocalBus
from common.clock import VirtualClock
from common.lockstep import Lockstep
from common.runner import Dispatcher
from common.service import Finish, Job, Publish, Report
from common.topics import ACK, EPISODE
from tests.samples import CODEC, ack, episode

MS = 1_000_000
FAR = 10**12


class Member:
    """Calls `react(now_ms, inbox)` at every step and notes what it was shown in a common diary."""

    def __init__(self, name, diary, react, inputs=(), period_ns=None):
        self.name, self.inputs, self.period_ns, self.boot_id = name, inputs, period_ns, 1
        self._diary, self._react = diary, react

    def step(self, now_ns, inbox):
        now = now_ns // MS
        heard = [s.message.episode for spec in self.inputs for s in inbox.take(spec.topic)]
        results = [(r.name, r.value, r.error, r.duration_ns // MS) for r in inbox.results]
        self._diary.append((now, self.name, inbox.ticks, heard, results))
        return self._react(now, heard)

    def stop(self, now_ns):
        self._diary.append((now_ns // MS, self.name, "stop"))
        return []

    def report(self):
        return Report("fine")


def lockstep(*members):
    bus = LocalBus()
    return Lockstep([Dispatcher(member, CODEC, bus, {}) for member in members], VirtualClock())


def quiet(now, heard):
    return []


def never():
    return False


def test_services_step_at_their_ticks_in_the_order_given():
    diary = []
    run = lockstep(
        Member("slow", diary, quiet, period_ns=20 * MS), Member("fast", diary, quiet, period_ns=10 * MS)
    )
    assert run.run(never, 20 * MS) is False
    assert diary == [
        (0, "slow", 1, [], []),
        (0, "fast", 1, [], []),
        (10, "fast", 1, [], []),
        (20, "slow", 1, [], []),
        (20, "fast", 1, [], []),
    ]
    assert run.clock.time_ns == 20 * MS


def test_a_service_without_a_period_makes_a_first_step_and_then_waits():
    diary = []
    run = lockstep(Member("a", diary, quiet))
    assert run.run(never, FAR) is False  # nothing will ever happen
    assert diary == [(0, "a", 0, [], [])]


def test_a_message_arrives_at_the_time_it_is_sent_also_upstream():
    diary = []

    def sender(now, heard):
        return [Publish(EPISODE, episode(now))] if now == 10 and not heard else []

    def echo(now, heard):
        return [Publish(ACK, ack(number)) for number in heard]

    run = lockstep(
        Member("sender", diary, sender, (Input(ACK, wake=True),), 10 * MS),
        Member("echo", diary, echo, (Input(EPISODE, wake=True),)),
    )
    run.run(never, 15 * MS)
    assert diary == [
        (0, "sender", 1, [], []),
        (0, "echo", 0, [], []),
        (10, "sender", 1, [], []),
        (10, "echo", 0, [10], []),
        (10, "sender", 0, [10], []),
    ]


def test_a_result_appears_after_the_declared_latency_and_jobs_of_a_service_queue():
    diary = []

    def worker(now, heard):
        return [Job("a", str, (now,), 30 * MS), Job("b", str, (now,), 5 * MS)] if now == 0 else []

    def other(now, heard):
        return [Job("c", str, (now,), 32 * MS)] if now == 0 else []

    run = lockstep(Member("worker", diary, worker), Member("other", diary, other))
    run.run(never, FAR)
    assert [row for row in diary if row[4]] == [
        (30, "worker", 0, [], [("a", "0", "", 30)]),
        (32, "other", 0, [], [("c", "0", "", 32)]),  # another service's jobs do not wait for it
        (35, "worker", 0, [], [("b", "0", "", 5)]),
    ]


def test_a_free_worker_begins_at_once_later_on():
    diary = []

    def worker(now, heard):
        return [Job("a", str, (), 3 * MS)] if now in (0, 10) else []

    lockstep(Member("worker", diary, worker, period_ns=10 * MS)).run(never, 15 * MS)
    assert [row[0] for row in diary if row[4]] == [3, 13]


def test_a_job_that_fails_is_a_result():
    diary = []

    def worker(now, heard):
        return [Job("bad", int, ("x",), MS)] if now == 0 else []

    lockstep(Member("worker", diary, worker)).run(never, FAR)
    error = "ValueError: invalid literal for int() with base 10: 'x'"
    assert diary[1:] == [(1, "worker", 0, [], [("bad", None, error, 1)])]


@pytest.mark.parametrize("when", ["condition", "finish"])
def test_a_run_ends_when_it_should(when):
    diary = []

    def finisher(now, heard):
        return [Finish()] if when == "finish" and now == 30 else []

    run = lockstep(Member("a", diary, finisher, period_ns=10 * MS))
    condition = never if when == "finish" else lambda: len(diary) == 4
    assert run.run(condition, FAR) is True
    assert [row[0] for row in diary] == [0, 10, 20, 30]
    run.close()
    assert diary[-1] == (30, "a", "stop")


def test_time_never_steps_back_when_a_run_goes_on():
    diary = []
    run = lockstep(Member("a", diary, quiet, period_ns=10 * MS))
    run.run(never, 25 * MS)
    run.run(never, 45 * MS)
    assert [row[0] for row in diary] == [0, 10, 20, 30, 40]

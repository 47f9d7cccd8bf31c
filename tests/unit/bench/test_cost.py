"""Each second of processor time is charged to one account, and to the right one."""

import json

import pytest

from bench import cost
from bench.cost import Meter, MeteredDispatcher, cost_line, training_cost
from common.built import codec_for
from common.bus import LocalBus
from common.service import Job, Report


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def process_time(self):
        return self.now_s

    def spend(self, s):
        self.now_s += s


class Busy:
    """Spends 2 s in its step, 1 s of it after having started a job of 10 s."""

    inputs = ()
    period_ns = None
    boot_id = 1

    def __init__(self, name, clock, job):
        self.name, self._clock, self._job = name, clock, job

    def step(self, now_ns, inbox):
        self._clock.spend(2.0)
        return [Job(self._job, self._clock.spend, (10.0,))]

    def stop(self, now_ns):
        return []

    def report(self):
        return Report("ready", {})


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(cost, "time", clock)
    return clock


@pytest.mark.parametrize(
    ("service", "job", "spent_s"),
    [
        ("planner", "plan", {"plan": 12.0}),
        ("learner", "update", {"train": 12.0}),
        ("sim", "draw", {"simulate": 12.0}),
        ("curriculum", "commit", {"other": 12.0}),
        ("agent", "learn", {"train": 12.0}),
        ("agent", "act", {"train": 2.0, "plan": 10.0}),
    ],
)
def test_a_service_and_its_jobs_are_charged_to_what_they_do(clock, service, job, spent_s):
    meter = Meter()
    clock.spend(3.0)
    dispatcher = MeteredDispatcher(meter, Busy(service, clock, job), codec_for("reach"), LocalBus(), {})
    dispatcher.step(0, 0, lambda started: started.function(*started.arguments))
    clock.spend(4.0)
    expected = {**dict.fromkeys(cost.KINDS, 0.0), **spent_s}
    assert meter.read() == {**expected, "other": expected["other"] + 7.0}


def test_a_run_that_was_not_metered_has_no_split(tmp_path):
    notes = [{"session": 0, "episode": e, "wall_s": 2.0 * e} for e in range(3)]
    (tmp_path / "timing.jsonl").write_text("".join(json.dumps(note) + "\n" for note in notes))
    found = training_cost(tmp_path, [])
    assert found == {"wall_s": 4.0, "cpu_s": None}
    assert cost_line(found) == "training took 4 s"


def test_the_split_is_printed_as_shares():
    spent = {"plan": 30.0, "train": 50.0, "simulate": 15.0, "other": 5.0}
    line = cost_line({"wall_s": 400.0, "cpu_s": spent})
    assert line == "training took 400 s, 100 s of CPU: plan 30%, train 50%, simulate 15%, other 5%"

"""The viewer listens, never waits, and counts what it cannot show."""

import time

import pytest

from common.built import codec_for
from common.bus import Inbox, JobResult
from common.runner import run_job
from common.topics import STEP
from deploy.viewer.build import ViewerProcess, build
from deploy.viewer.service import ViewerService
from tests.unit.deploy.viewer_samples import step

CODEC = codec_for("reach")


class Canvas:
    """Remembers what was drawn."""

    url = ""

    def __init__(self):
        self.drawn = []
        self.closed = False

    def open(self):
        pass

    def draw(self, samples):
        self.drawn += [sample.message.k for sample in samples]

    def close(self):
        self.closed = True


class Rig:
    """A viewer whose worker does a job only when told to."""

    def __init__(self, queue):
        self.canvas = Canvas()
        self.service = ViewerService(self.canvas, boot_id=1, period_ns=100_000_000, queue=queue)
        self.inbox = Inbox(CODEC, self.service.inputs)
        self.jobs = []

    def send(self, *ks):
        for k in ks:
            sample = step("reach", k, seq=k)
            self.inbox.sink(STEP)("control/step", CODEC.encode(sample.header, sample.message))

    def tick(self):
        self.inbox.collect(0, 1)
        self.jobs += self.service.step(0, self.inbox)

    def work(self):
        job = self.jobs.pop(0)
        value, error = run_job(job)
        self.inbox.finish(JobResult(job.name, value, error, 0))


@pytest.fixture
def rig():
    return Rig(queue=3)


def test_it_opens_first_and_draws_what_came_meanwhile(rig):
    rig.send(0, 1)
    rig.tick()
    assert [job.name for job in rig.jobs] == ["open"]
    rig.work()
    rig.tick()
    rig.work()
    assert rig.canvas.drawn == [0, 1]


def test_a_stuck_worker_costs_samples_and_never_time(rig):
    rig.tick()
    begin = time.perf_counter()
    for k in range(100):
        rig.send(k)
        rig.tick()
    assert time.perf_counter() - begin < 5.0
    assert len(rig.jobs) == 1
    assert rig.service.report().fields["dropped"] == 97
    rig.work()
    rig.tick()
    rig.work()
    assert rig.canvas.drawn == [97, 98, 99]


def test_a_failing_canvas_is_told_and_tried_again(rig):
    def fail(samples):
        raise RuntimeError("disk full")

    rig.canvas.draw = fail
    rig.tick()
    rig.work()
    for k in (0, 1):
        rig.send(k)
        rig.tick()
        rig.work()
    rig.tick()
    report = rig.service.report()
    assert report.state == "draw: RuntimeError: disk full"
    assert report.fields["failed"] == 2


def test_stopping_closes_the_canvas_and_publishes_nothing(rig):
    assert rig.service.stop(0) == []
    assert rig.canvas.closed


def test_build_needs_no_viewer_to_be_open(tmp_path):
    built = build(ViewerProcess(run_dir=tmp_path), boot_id=5)
    assert built.service.boot_id == 5
    assert list(tmp_path.iterdir()) == []

"""The dispatcher carries out what a service wants, in order, and survives what cannot be sent."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from common.bus import Input, JobResult, LocalBus
from common.buslog import Entry
from common.messages import Header, PlantCommand
from common.runner import Dispatcher, run_job
from common.service import Finish, Job, Publish, Report, ToPort
from common.topics import CHUNK, EPISODE, HEALTH, PLANT_COMMAND, PLANT_FRAME, STEP
from tests.samples import CODEC, HEALTH_0, G, S, chunk, episode, frame, step

EMPTY = np.zeros(0, np.float32)
HEADER = Header(1, 2, 3, True)
COMMAND = PlantCommand(True, 7, EMPTY, EMPTY)


class Scripted:
    """Returns what it was told to and remembers what it was shown."""

    name = "scripted"
    inputs = (Input(STEP), Input(PLANT_FRAME, wake=True))
    period_ns = None
    boot_id = 9

    def __init__(self, *scripts):
        self.scripts = list(scripts)
        self.seen = []

    def step(self, now_ns, inbox):
        self.seen.append((now_ns, inbox.ticks, len(inbox.take(STEP)), len(inbox.take(PLANT_FRAME))))
        return self.scripts.pop(0) if self.scripts else []

    def stop(self, now_ns):
        return [Publish(EPISODE, episode(99))]

    def report(self):
        return Report("fine")


class Device:
    name = "plant"

    def __init__(self):
        self.written = []
        self.closed = False

    def open(self, deliver):
        self.deliver = deliver

    def write(self, message):
        self.written.append(message)
        self.deliver(PLANT_FRAME, frame(reset=message.reset))

    def close(self):
        self.closed = True


class Log(list):
    closed = False

    def write(self, entry):
        self.append(entry)

    def flush(self):
        pass

    def close(self):
        self.closed = True


@pytest.fixture
def world():
    """Make a dispatcher of a scripted service, what it logs, its device and what it sends."""

    def make(*scripts):
        bus, device, log, heard = LocalBus(), Device(), Log(), []
        for topic in (CHUNK, EPISODE, HEALTH):
            bus.subscribe(topic, lambda key, payload: heard.append(CODEC.decode(key, payload)))
        dispatcher = Dispatcher(Scripted(*scripts), CODEC, bus, {"plant": device}, log)
        return dispatcher, bus, device, log, heard

    return make


def no_job(job):
    raise AssertionError(f"{job} was not expected")


def test_outputs_are_carried_out_in_order_and_stamped(world):
    outputs = [
        Publish(CHUNK, chunk()),
        Publish(CHUNK, chunk(), t_ns=5, valid=False),
        Publish(HEALTH, HEALTH_0, suffix="scripted"),
        Publish(EPISODE, episode()),
    ]
    dispatcher, _, _, _, heard = world(outputs)
    dispatcher.step(100, 1, no_job)
    assert [sample.key for sample in heard] == ["control/chunk"] * 2 + ["health/scripted", "task/episode"]
    headers = [sample.header for sample in heard]
    assert [h.seq for h in headers] == [0, 1, 0, 0]  # counted per key
    assert [h.t_ns for h in headers] == [100, 5, 100, 100]
    assert [h.valid for h in headers] == [True, False, True, True]
    assert {h.boot_id for h in headers} == {9}


def test_what_breaks_its_contract_is_counted_not_raised_and_the_rest_goes_on(world):
    bad = chunk(predicted_state=np.full(S, np.nan, np.float32))
    worse = replace(COMMAND, goal=np.full(G, np.inf, np.float32))
    script = [
        Publish(CHUNK, bad),
        ToPort("plant", PLANT_COMMAND, worse),
        Publish(EPISODE, episode()),
    ]
    dispatcher, _, device, log, heard = world(script)
    dispatcher.step(0, 1, no_job)
    assert dispatcher.unsendable == 2
    assert dispatcher.last_error == "port/plant/command: not sent: goal: not finite"
    assert [sample.key for sample in heard] == ["task/episode"]
    assert device.written == []
    assert [entry.key for entry in log if entry.kind == "out"] == ["task/episode"]


def test_the_device_gets_the_command_and_its_frames_come_in_through_the_inbox(world):
    dispatcher, _, device, _, _ = world([], [ToPort("plant", PLANT_COMMAND, COMMAND)])
    dispatcher.open()
    dispatcher.step(0, 1, no_job)
    dispatcher.step(10, 1, no_job)
    assert device.written == [COMMAND]
    assert dispatcher.inbox.wake.is_set()
    dispatcher.step(10, 0, no_job)
    assert dispatcher.service.seen == [(0, 1, 0, 0), (10, 1, 0, 0), (10, 0, 0, 1)]
    sample = dispatcher.inbox.newest(PLANT_FRAME)
    assert (sample.header.boot_id, sample.header.seq, sample.header.t_ns) == (9, 0, 10)


def test_opening_subscribes_and_calls_for_a_first_step(world):
    dispatcher, bus, _, _, _ = world()
    assert not dispatcher.inbox.wake.is_set()
    dispatcher.open()
    assert dispatcher.inbox.wake.is_set()
    bus.publish(STEP, "control/step", CODEC.encode(HEADER, step()))
    dispatcher.step(0, 0, no_job)
    assert dispatcher.service.seen == [(0, 0, 1, 0)]


def test_the_log_holds_inputs_and_results_before_their_step_and_outputs_after_it(world):
    dispatcher, _, _, log, _ = world([Publish(CHUNK, chunk())])
    payload = CODEC.encode(HEADER, step())
    dispatcher.inbox.sink(STEP)("control/step", payload)
    dispatcher.inbox.finish(JobResult("plan", None, "", 77))
    dispatcher.step(40, 3, no_job)
    assert [(e.kind, e.t_ns, e.key) for e in log] == [
        ("in", 40, "control/step"),
        ("result", 40, "plan"),
        ("step", 40, "scripted"),
        ("out", 40, "control/chunk"),
    ]
    assert log[0] == Entry("in", 40, "control/step", payload)
    assert [struct.unpack("<q", e.payload)[0] for e in log[1:3]] == [77, 3]


def test_jobs_go_to_the_runner_and_finishing_is_remembered(world):
    job = Job("plan", len, ("abc",))
    dispatcher, *_ = world([job, Finish(3)])
    started = []
    dispatcher.step(0, 1, started.append)
    assert started == [job]
    assert dispatcher.finish == Finish(3)


def test_closing_sends_what_the_service_leaves_and_closes_device_and_log(world):
    dispatcher, _, device, log, heard = world()
    dispatcher.open()
    dispatcher.close(50)
    assert [(sample.message.episode, sample.header.t_ns) for sample in heard] == [(99, 50)]
    assert device.closed and log.closed


def fail(text):
    raise ValueError(text)


@pytest.mark.parametrize(
    ("job", "expected"),
    [
        (Job("a", len, ("abc",)), (3, "")),
        (Job("a", fail, ("two\n  lines",)), (None, "ValueError: two lines")),
        (Job("a", fail, ("",)), (None, "ValueError: ValueError")),
        (Job("a", lambda: {}["x"]), (None, "KeyError: 'x'")),
    ],
)
def test_a_job_gives_its_value_or_one_line(job, expected):
    assert run_job(job) == expected

"""The bench of the hand's bus, briefly: that it measures, not what."""

import json

import pytest

from bench import can
from bench.can import LIMITS, HandProcess, Measured, main, measure, result
from common.can_link import Busy
from common.dexhand021 import device
from common.dexhand021.replies import BoardFeedback, MotorState


class Answering:
    """A bus on which six boards answer at once, save to the commands in `lost` and `full`."""

    def __init__(self, lost=(), full=()):
        self.lost, self.full, self.commands, self.waiting = lost, full, 0, []
        self.told = []

    def send(self, frame):
        self.told.append(device.decode(frame))
        self.commands += 1
        if self.commands in self.full:
            raise Busy
        boards = range(7, 12 if self.commands in self.lost else 13)
        motors = (MotorState(0, 0, 0, 0),) * 2
        self.waiting += [device.encode(BoardFeedback(board, motors), 16) for board in boards]

    def receive(self, _timeout_s):
        return self.waiting.pop(0) if self.waiting else None


def test_cycles_without_the_sixth_answer_are_lost_and_the_others_timed(monkeypatch):
    monkeypatch.setattr(can, "LOST_MS", 250.0)
    found = measure(Answering(lost=(2, 5), full=(7,)), 10, 200.0)
    assert (len(found.round_trips_ms), found.lost, found.unsent) == (7, 2, 1)
    figures = result(found, HandProcess(0.005), 10, 200.0)
    assert figures["lost_cycles"] == 3 and set(LIMITS) <= set(figures)
    assert figures["hand_cpu_ms_per_cycle"] == 0.5


def test_no_motor_is_told_to_leave_its_range():
    bus = Answering()
    measure(bus, 1, 200.0)
    (command,) = bus.told
    degrees = [motor.position / 100 for motor in command.motors]
    assert degrees == [20.0] * 3 + [17.18] + [20.0] * 8  # the spread goes to 0.3 rad


@pytest.mark.parametrize(
    ("round_trips_ms", "lost", "passed"),
    [
        ([2.0] * 98 + [8.0] * 2, 20, True),
        ([2.01] * 100, 0, False),  # the median
        ([1.0] * 98 + [8.1] * 2, 0, False),  # the 99th percentile
        ([1.0] * 100, 21, False),
    ],
)
def test_a_figure_above_its_limit_does_not_pass(round_trips_ms, lost, passed):
    found = result(Measured(round_trips_ms, lost=lost), HandProcess(), 121, 100.0)
    assert found["passed"] is passed


@pytest.mark.processes
def test_it_measures_a_hand_in_another_process(capsys):
    main(["--cycles", "50", "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["cycles"] == 50 and 0 < figures["round_trip_ms_p50"] <= figures["round_trip_ms_p99"]
    assert figures["cpu_ms_per_cycle"] > 0 and figures["hand_cpu_ms_per_cycle"] > 0

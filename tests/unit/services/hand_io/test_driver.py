"""The driver when the bus is busy, goes away and comes back; with a bus that does what the test says."""

import queue
import time

import numpy as np
import pytest

from common.can_config import CanConfig
from common.can_link import BadFrame, BusOff, Busy, LinkError
from common.dexhand021 import device
from common.dexhand021.config import DexHandConfig
from common.dexhand021.frames import Frame
from common.dexhand021.replies import BoardFeedback, MotorState
from common.hand_messages import Drive, HandCommand, Link
from services.hand_io.config import HandIoConfig
from services.hand_io.driver import BUSY_CYCLES, HandPort

HOLD = HandCommand(Drive.HOLD, np.zeros(0, np.float32), 0)


class FakeLink:
    """Answers every command at once, unless told to raise."""

    def __init__(self):
        self.sent, self.replies = [], queue.SimpleQueue()
        self.send_error = None
        self.lost = []  # of the next cycles: how many of the six answers get lost
        self.closed = False

    def send(self, frame):
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(frame)
        for board in range(7 + (self.lost.pop(0) if self.lost else 0), 13):
            motors = (MotorState(0, 0, 0, 1000),) * 2
            self.replies.put(device.encode(BoardFeedback(board, motors), 16))

    def receive(self, timeout_s):
        try:
            item = self.replies.get(timeout=min(timeout_s, 0.02))
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def close(self):
        self.closed = True


class Driven:
    def __init__(self):
        self.links, self.frames, self.fails = [], [], False
        config = HandIoConfig(set_point_hz=100, stale_ms=1000, reopen_s=0.03, max_reopen_s=0.06)
        self.port = HandPort(CanConfig(interface="virtual"), DexHandConfig(), config, self._open)
        self.port.open(lambda _topic, frame: self.frames.append(frame))

    def _open(self, config, bit_rate_switch):
        if self.fails:
            raise LinkError("no such device")
        self.links.append(FakeLink())
        return self.links[-1]

    def wait(self, reached, seconds=3.0):
        deadline = time.monotonic() + seconds
        while not (self.frames and reached(self.frames[-1])):
            assert time.monotonic() < deadline, self.frames and self.frames[-1]
            time.sleep(0.003)
        return self.frames[-1]


@pytest.fixture
def driven():
    hand = Driven()
    hand.wait(lambda frame: frame.link is Link.UP and frame.age_ms.max() < 50)
    yield hand
    hand.port.close()


def test_every_cycle_sends_one_frame_and_tells_what_came_back(driven):
    count, begun = len(driven.frames), time.monotonic()
    driven.wait(lambda _frame: len(driven.frames) >= count + 10)
    assert len(driven.frames) - count <= 2 + 100 * (time.monotonic() - begun)  # it never bursts to catch up
    frame = driven.wait(lambda frame: "round_trip_ms_p50" in frame.counts)
    assert np.allclose(np.degrees(frame.angle_rad), 10, atol=0.01)
    assert (frame.rate_hz > 0).all()
    assert frame.drive is Drive.OFF and not frame.force_valid.any()


@pytest.mark.parametrize("answers", [1, 6])
def test_a_lost_cycle_is_counted_and_the_next_frame_says_everything_again(driven, answers):
    driven.port.write(HOLD)
    before = driven.wait(lambda frame: frame.enabled.all())
    at = len(driven.links[0].sent)
    driven.links[0].lost = [answers] * 3
    driven.wait(lambda frame: frame.counts.get("late_cycles", 0) >= before.counts.get("late_cycles", 0) + 3)
    after = driven.wait(lambda frame: frame.age_ms.max() < 20)
    commands = [device.decode(frame) for frame in driven.links[0].sent[at:]]
    assert all(command.request_feedback for command in commands)
    assert {tuple(motor.enabled for motor in command.motors) for command in commands} == {(True,) * 12}
    assert len({tuple(motor.position for motor in command.motors) for command in commands}) == 1
    assert after.drive is Drive.HOLD and after.link is Link.UP and after.counts["opens"] == 1


def test_a_full_queue_is_tried_again_and_counted_and_nothing_else_happens(driven):
    driven.port.write(HOLD)
    driven.links[0].send_error = Busy()
    driven.wait(lambda frame: frame.counts.get("busy", 0) > 3)
    driven.links[0].send_error = None
    frame = driven.wait(lambda frame: frame.age_ms.max() < 20)
    assert frame.link is Link.UP and len(driven.links) == 1 and frame.drive is Drive.HOLD


def test_a_queue_that_stays_full_and_a_lost_device_are_opened_again_without_torque(driven):
    driven.port.write(HOLD)
    driven.links[0].send_error = Busy()
    frame = driven.wait(lambda frame: frame.counts.get("opens", 0) == 2)
    assert frame.counts["busy"] == BUSY_CYCLES and driven.links[0].closed
    assert driven.port.last_error == "nothing can be sent: the queue stays full"
    driven.fails = True
    driven.links[1].send_error = LinkError("network is down")
    frame = driven.wait(lambda frame: frame.link is Link.DOWN)
    assert frame.error in ("network is down", "no such device")
    driven.fails = False
    frame = driven.wait(lambda frame: frame.link is Link.UP and frame.age_ms.max() < 50)
    assert frame.drive is Drive.OFF and not frame.enabled.any() and not frame.error


@pytest.mark.parametrize("where", ["send", "receive"])
def test_bus_off_lasts_until_a_board_is_heard_again(driven, where):
    if where == "send":
        driven.links[0].send_error = BusOff()
    else:
        driven.links[0].replies.put(BusOff())
    driven.wait(lambda frame: frame.link is Link.BUS_OFF)
    frame = driven.wait(lambda frame: frame.link is Link.UP and frame.counts["opens"] == 2)
    assert frame.drive is Drive.OFF and not frame.enabled.any()


def test_what_is_no_frame_is_counted(driven):
    driven.links[0].replies.put(BadFrame("nonsense"))
    driven.links[0].replies.put(Frame(0x7F0, b""))
    driven.links[0].replies.put(Frame(0x107, b""))
    frame = driven.wait(lambda frame: frame.counts.get("commands_heard", 0) == 1)
    assert (frame.counts["bad_frames"], frame.counts["refused_frames"]) == (1, 1)


def test_closing_takes_the_torque_off():
    hand = Driven()
    hand.wait(lambda frame: frame.link is Link.UP and frame.age_ms.max() < 50)
    hand.port.write(HOLD)
    hand.wait(lambda frame: frame.enabled.all())
    hand.port.close()
    last = device.decode(hand.links[0].sent[-1])
    assert not any(motor.enabled for motor in last.motors) and hand.links[0].closed

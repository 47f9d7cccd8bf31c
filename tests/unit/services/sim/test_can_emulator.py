"""The emulated hand frame by frame, with hand-made time."""

import numpy as np
import pytest

from common.dexhand021 import host
from common.dexhand021.commands import (
    BoardMotion,
    BroadcastMotion,
    ClearError,
    FeedbackSetting,
    MotorTarget,
    NvmRead,
)
from common.dexhand021.config import DexHandConfig
from common.dexhand021.frames import Frame
from common.dexhand021.replies import ConfigReply, ErrorReport, MotorFlag, NvmReply, OverTemperature, Startup
from common.dexhand021.tables import ControlMode, FeedbackMode, Hand, NvmAddress
from services.hand_io.config import CUP_RAD
from services.sim import dexhand_twin
from services.sim.can_emulator import EmulatedHand
from services.sim.emulator_config import EmulatorConfig, EmulatorProcess, Fault
from tests.unit.services.hand_io.kinematic import KinematicTwin

MS = 1_000_000
PID = ControlMode.CASCADED_PID


class Bench:
    def __init__(self, *faults, **config):
        self.twin, self.now_ns = KinematicTwin(), 0
        faults = tuple(Fault(**fault) for fault in faults)
        self.hand = EmulatedHand(DexHandConfig(), EmulatorConfig(faults=faults, **config), self.twin, 0)
        self.said = []

    def send(self, command):
        return [host.decode(frame) for _, frame in self.hand.receive(self.now_ns, host.encode(command))]

    def move(self, deg=10.0, enabled=True, mode=PID, hand=Hand.RIGHT):
        targets = (MotorTarget(enabled, round(100 * deg)),) * 12
        return self.send(BroadcastMotion(hand, mode, targets))

    def go(self, ms=10, times=1, **motion):
        for _ in range(times):
            answers = self.move(**motion)
            self.now_ns += ms * MS
            self.said += [host.decode(frame) for frame in self.hand.advance(self.now_ns)]
        return answers


def test_six_boards_answer_at_the_right_lengths():
    for length, padded in ((16, 16), (42, 48), (56, 64)):
        bench = Bench(feedback_bytes=length)
        command = BroadcastMotion(Hand.RIGHT, PID, (MotorTarget(True, 0),) * 12)
        frames = bench.hand.receive(0, host.encode(command))
        assert [frame.can_id for _, frame in frames] == list(range(0x187, 0x18D))
        assert {len(frame.data) for _, frame in frames} == {padded}


def test_motors_go_where_they_are_told_and_say_where_they_are():
    bench = Bench()
    answers = bench.go(times=60, deg=20.0)
    assert [motor.angle_cdeg for motor in answers[2].motors] == [2000, 2000]
    assert answers[3].tactile.normal_n == pytest.approx(0.2) and answers[1].tactile is None
    assert np.degrees(bench.twin.targets[3]) == pytest.approx(20.0)  # beyond its range: the physics' business
    assert bench.hand.counts["beyond_range"] == 60


def test_disabled_motors_other_modes_and_the_other_hand_move_nothing():
    bench = Bench()
    for motion in ({"enabled": False}, {"mode": ControlMode.CURRENT}, {"hand": Hand.LEFT}):
        bench.go(times=10, **motion)
        assert not bench.hand.powered.any()
    assert bench.twin.moved_rad == 0.0 and bench.move(hand=Hand.LEFT) == []


def test_silence_takes_the_torque_off():
    bench = Bench(silence_s=0.1)
    bench.go()
    assert bench.hand.powered.all()
    for _ in range(12):
        bench.now_ns += 10 * MS
        bench.hand.advance(bench.now_ns)
    assert not bench.hand.powered.any()


def test_one_board_alone_is_moved_and_read():
    bench = Bench()
    pair = (MotorTarget(True, 2500), MotorTarget(False, 0))
    (answer,) = bench.send(BoardMotion(9, PID, pair))
    assert answer.board == 9
    bench.hand.advance(10 * MS)
    assert np.flatnonzero(bench.hand.powered).tolist() == [4]
    assert bench.send(NvmRead(9, NvmAddress.FIRMWARE)) == [NvmReply(9, NvmAddress.FIRMWARE, 25418)]
    assert bench.send(NvmRead(9, NvmAddress.BOARD_ID)) == [NvmReply(9, NvmAddress.BOARD_ID, 9)]
    assert bench.send(FeedbackSetting(9, FeedbackMode.PERIODIC, 10, True)) == [ConfigReply(9, 0x74, ok=False)]
    assert bench.send(NvmRead(3, NvmAddress.FIRMWARE)) == []


def test_a_stall_is_latched_until_cleared_on_its_board():
    bench = Bench({"kind": "stall", "board": "index", "motor": 2, "at_s": 0.05, "for_s": 0.05})
    bench.go(times=7)
    (report,) = bench.said
    assert isinstance(report, ErrorReport) and report.board == 9
    assert report.flags == (MotorFlag(0), MotorFlag.STALL)
    bench.go(times=10)
    assert not bench.hand.powered[5] and bench.move()[2].errors == (MotorFlag(0), MotorFlag.STALL)
    clear_all = BroadcastMotion(Hand.RIGHT, PID, (MotorTarget(True, 1000),) * 12, clear_errors=True)
    assert bench.send(clear_all)[2].errors[1]  # broadcast clearing is reported to do nothing
    assert bench.send(ClearError(9)) == [ConfigReply(9, 0xA4, ok=True)]
    bench.go(times=2)
    assert bench.hand.powered.all()


def test_heat_powers_the_hand_off_and_boards_start_anew():
    bench = Bench({"kind": "overheat", "board": "ring", "at_s": 0.02, "for_s": 0.05})
    answers = [bench.go() for _ in range(12)]
    assert bench.said[0] == OverTemperature(11) and bench.move() != []
    started = [reply for reply in bench.said[1:] if isinstance(reply, Startup)]
    assert started == [Startup(board, bytes(8)) for board in range(7, 13)]
    assert [len(each) for each in answers[:9]] == [6, 6, 0, 0, 0, 0, 0, 6, 6]


def test_declared_disturbances_of_the_bus():
    assert len(Bench({"kind": "duplicate"}).move()) == 12
    assert len(Bench({"kind": "silent", "board": "palm"}).move()) == 5
    assert Bench({"kind": "bus_off"}).move() == []
    assert Bench({"kind": "nan_tactile", "board": "thumb"}).move()[0].tactile.normal_n is None
    assert Bench({"kind": "warm", "board": "thumb", "amount": 52}).move()[0].temperature_c == 52
    bench = Bench({"kind": "reorder"})
    bench.move()
    assert [reply.board for reply in bench.move()] == [*range(12, 6, -1), *range(7, 13)]
    bench = Bench({"kind": "delay", "amount": 30})
    command = host.encode(BroadcastMotion(Hand.RIGHT, PID, (MotorTarget(True, 0),) * 12))
    assert {due for due, _ in bench.hand.receive(5, command)} == {30 * MS + 5}


def test_sensors_drift_and_joints_do_not():
    bench = Bench({"kind": "drift", "board": "index", "amount": 0.1, "for_s": 1.0})
    answers = bench.go(times=60, deg=20.0)
    assert answers[2].motors[0].angle_cdeg == pytest.approx(2000 + 100 * np.degrees(0.06), abs=15)
    assert np.degrees(bench.twin.joint_angles_rad[4]) == pytest.approx(20.0)


def test_any_bytes_are_answered_or_refused():
    bench, rng = Bench(), np.random.default_rng(3)
    for _ in range(5000):
        frame = Frame(int(rng.integers(0, 0x800)), rng.bytes(int(rng.choice([0, 2, 6, 8, 12, 64]))))
        bench.hand.receive(0, frame)
    assert bench.hand.counts["refused"] > 4900


def test_an_emulated_hand_keeps_away_from_real_buses_and_starts_as_hand_io_does():
    with pytest.raises(ValueError, match="no place on socketcan"):
        EmulatorProcess.model_validate({"task": "die", "can": {"interface": "socketcan", "channel": "can0"}})
    assert np.allclose(dexhand_twin.CUP_RAD, CUP_RAD)

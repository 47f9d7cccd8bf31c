"""`deploy.doctor can` and `deploy.arm`, beside an emulated hand."""

import subprocess
import time

import pytest

from bench.can import free_port
from common.can_config import CanConfig
from common.can_link import LinkError
from common.config import ConfigError
from common.dexhand021 import device
from common.dexhand021.commands import BroadcastMotion, NvmRead
from common.dexhand021.config import DexHandConfig
from common.dexhand021.replies import BoardFeedback, ErrorReport, MotorFlag, MotorState, NvmReply
from common.dexhand021.tables import ControlMode
from common.hand_messages import ArmReply, ArmWish
from common.task import get_task
from deploy import arm, doctor, doctor_can
from deploy.cell import load_cell
from deploy.doctor_can import _bit_rates, _hand, checks
from services.hand_io.desk import ArmDesk
from services.sim.emulator_config import EmulatorConfig, Fault
from services.sim.emulator_port import EmulatorPort
from tests.unit.services.hand_io.kinematic import KinematicTwin


@pytest.fixture
def emulated():
    """A function that starts a hand with faults and returns the lines about it."""
    ports = []

    def examine(*faults, overrides=(), status=True):
        number = free_port()
        config = EmulatorConfig(faults=tuple(Fault(for_s=60, **fault) for fault in faults))
        can = CanConfig(port=number)
        ports.append(EmulatorPort(can, DexHandConfig(), config, KinematicTwin(), get_task("die")))
        ports[-1].open(lambda _topic, _message: None)
        cell = [f"can.port={number}", *overrides]
        return list(checks("dexhand_twin", cell, status=status)), ports[-1]

    yield examine
    for port in ports:
        port.close()


def test_a_healthy_hand_passes_and_is_not_moved(emulated):
    lines, port = emulated()
    assert all(line.ok for line in lines), [str(line) for line in lines]
    assert [line.about for line in lines[:3]] == ["adapter", "bit rates", "traffic"]
    assert lines[2].found == "the bus is quiet"
    assert "firmware 25418" in lines[3].found and "30 °C" in lines[3].found
    assert "powers off at 55 °C" in lines[3].found and "round trip" in lines[3].found
    assert not port.hand.powered.any()


def test_each_board_that_is_not_well_is_named(emulated):
    lines, _ = emulated(
        {"kind": "silent", "board": "palm"}, {"kind": "warm", "board": "ring", "amount": 52.0}
    )
    failed = {line.about: line.found for line in lines if not line.ok}
    assert set(failed) == {"palm (id 8)", "ring (id 11)"}
    assert failed["palm (id 8)"] == "does not answer" and "too hot to run" in failed["ring (id 11)"]


def test_the_other_hand_on_the_bus_is_named(emulated, monkeypatch):
    monkeypatch.setattr(doctor_can, "ANSWER_S", 0.01)
    lines, port = emulated(overrides=["hand.hand=left", "task=die_left"])
    assert len(lines) == 9 and not any(line.ok for line in lines[3:])
    assert "same can.channel and can.port?" in str(lines[3])
    assert not port.hand.powered.any()
    cell = load_cell("dexhand_twin", ["hand.hand=left", "task=die_left"])
    frames = [device.encode(BoardFeedback(board, (MotorState(0, 0, 0, 0),) * 2), 16) for board in (7, 8)]
    found = list(_hand(cell, Heard(frames), status=False))
    assert str(found[1]).startswith("FAIL  hand") and "boards of a right hand are heard" in found[1].found


class Heard:
    """A link on which only this is heard."""

    def __init__(self, frames):
        self._frames = frames
        self.sent = []

    def send(self, frame):
        self.sent.append(device.decode(frame))

    def receive(self, timeout_s):
        if self._frames:
            return self._frames.pop()
        time.sleep(timeout_s)
        return None


def test_a_quiet_hand_may_be_holding_something_and_is_only_read(emulated, monkeypatch):
    lines, _ = emulated(status=False)
    assert "--status asks" in lines[2].found
    assert "firmware 25418" in lines[3].found and "°C" not in lines[3].found.partition("powers")[0]
    monkeypatch.setattr(doctor_can, "ANSWER_S", 0.001)
    monkeypatch.setattr(doctor_can, "LISTEN_S", 0.01)
    link = Heard([])
    list(_hand(load_cell("dexhand_twin"), link, status=False))
    assert {type(command) for command in link.sent} == {NvmRead}
    list(_hand(load_cell("dexhand_twin"), link, status=True))
    (motion,) = (command for command in link.sent if isinstance(command, BroadcastMotion))
    assert motion.mode is ControlMode.ZERO_TORQUE and not any(motor.enabled for motor in motion.motors)


class Reading(Heard):
    """A link on which these frames are heard, and memory is answered."""

    def send(self, frame):
        super().send(frame)
        command = self.sent[-1]
        self._frames.append(device.encode(NvmReply(command.board, command.address, 7)))


NONE, STALL, HALL = MotorFlag(0), MotorFlag.STALL, MotorFlag.HALL


@pytest.mark.parametrize(
    ("reports", "told", "found"),
    [
        ([], None, ""),
        ([(STALL, NONE)], None, "latched STALL"),
        ([(STALL, NONE)], (NONE, NONE), "latched STALL"),  # what a short status is padded with
        ([(STALL, NONE), (NONE, HALL)], None, "latched STALL HALL"),
        ([(STALL, NONE)], (NONE, HALL), "latched STALL HALL"),
        ([(NONE, NONE)], None, "latched an error without a code"),
    ],
)
def test_a_latched_error_fails_the_board_whoever_tells_of_it(reports, told, found, monkeypatch):
    monkeypatch.setattr(doctor_can, "LISTEN_S", 0.01)
    frames = [device.encode(ErrorReport(9, (bool(a or not b), bool(b)), (a, b), b"")) for a, b in reports]
    state = (MotorState(0, 0, 0, 0),) * 2
    status = BoardFeedback(9, state) if told is None else BoardFeedback(9, state, errors=told)
    frames.append(device.encode(status, 16 if told is None else 48))
    lines = list(_hand(load_cell("dexhand_twin"), Reading(frames), status=False))
    assert [line.about for line in lines if not line.ok] == (["index (id 9)"] if found else [])
    assert lines[3].found.endswith(found or "powers off at 7 °C")


REAL = ("plant=hand", "pose_source=perception", "hand_io.auto_arm=false")


def test_no_adapter_is_one_line_that_says_why(capsys, monkeypatch):
    def absent(*_arguments):
        raise LinkError("pcan PCAN_USBBUS1: PEAK's PCANBasic library is not installed")

    monkeypatch.setattr(doctor_can, "CanLink", absent)
    values = (*REAL, "can.interface=pcan", "can.channel=PCAN_USBBUS1")
    assert doctor.main(["can", "dexhand_twin", *(f"--set={value}" for value in values)]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("FAIL  adapter") and line.endswith("PCANBasic library is not installed")


@pytest.mark.parametrize(("data_bit_rate", "right"), [(5_000_000, True), (2_000_000, False)])
def test_bit_rates_are_those_of_the_maker(data_bit_rate, right):
    values = (*REAL, "can.interface=kvaser", "can.channel=0", f"can.data_bit_rate={data_bit_rate}")
    line = _bit_rates(load_cell("dexhand_twin", values))
    assert line.ok is right
    assert right or ("set to 1000000 and 2000000 bit/s" in str(line) and "1000000 and 5000000" in str(line))


KERNEL = '[{"linkinfo": {"info_data": {"bittiming": {"bitrate": %d}, "data_bittiming": {"bitrate": %d}}}}]'


@pytest.mark.parametrize(
    ("said", "found"),
    [
        (KERNEL % (1_000_000, 5_000_000), "ok bit rates 1000000 and 5000000 bit/s"),
        (KERNEL % (500_000, 2_000_000), "FAIL bit rates 500000 and 2000000 bit/s -> ip link set can0"),
        (
            "[{}]",
            "FAIL bit rates unknown -> ip link set can0 up type can bitrate 1000000 dbitrate 5000000 fd",
        ),
    ],
)
def test_bit_rates_of_socketcan_are_those_that_the_kernel_tells(monkeypatch, said, found):
    monkeypatch.setattr(subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 0, said))
    values = (*REAL, "can.interface=socketcan", "can.channel=can0")
    line = str(_bit_rates(load_cell("dexhand_twin", values)))
    assert " ".join(line.split()).startswith(found)


def test_a_cell_without_a_hand_on_a_bus_is_told_apart(capsys):
    assert doctor.main(["can", "die"]) == 1
    assert "cell die has no bus" in capsys.readouterr().out
    assert arm.main(["die"]) == 2
    assert capsys.readouterr().err == "cell die has no hand to arm: it is all in simulation\n"
    with pytest.raises(ConfigError, match="virtual is a bus within one process"):
        load_cell("dexhand_twin", ["can.interface=virtual"])


@pytest.mark.parametrize(
    ("arguments", "wish"),
    [([], ArmWish.ARM), (["--off"], ArmWish.DISARM), (["--status"], ArmWish.STATUS)],
)
def test_arm_says_what_hand_io_answers(arguments, wish, monkeypatch, capsys):
    asked = []

    def ask(cell, wish):
        asked.append((cell.cell, wish))
        return ArmReply(accepted=wish is not ArmWish.ARM, state="hold", reason="no bus")

    monkeypatch.setattr(arm, "ask", ask)
    assert arm.main(arguments) == (1 if wish is ArmWish.ARM else 0)
    assert asked == [("dexhand_twin", wish)]
    assert capsys.readouterr().out == "hand_io: hold: no bus\n"


def test_arm_without_a_cell_that_runs_is_one_line(capsys):
    assert arm.main(["no_such_cell"]) == 2
    assert arm.main(["--set", "bus.connect=[tcp/127.0.0.1:9]"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_the_desk_answers_nonsense_itself():
    desk = ArmDesk(5)
    desk.open(lambda _topic, _message: pytest.fail("passed on"))
    assert b"not understood" in desk.answer(b"open sesame")

"""`deploy.doctor can` and `deploy.arm`, beside an emulated hand."""

import pytest

from bench.can import free_port
from common.can_config import CanConfig
from common.dexhand021.config import DexHandConfig
from common.hand_messages import ArmReply, ArmWish
from common.task import get_task
from deploy import arm, doctor
from deploy.doctor_can import checks
from services.hand_io.desk import ArmDesk
from services.sim.emulator_config import EmulatorConfig, Fault
from services.sim.emulator_port import EmulatorPort
from tests.unit.services.hand_io.kinematic import KinematicTwin


@pytest.fixture
def emulated():
    """A function that starts a hand with faults and returns the lines about it."""
    ports = []

    def examine(*faults):
        number = free_port()
        config = EmulatorConfig(faults=tuple(Fault(for_s=60, **fault) for fault in faults))
        can = CanConfig(port=number)
        ports.append(EmulatorPort(can, DexHandConfig(), config, KinematicTwin(), get_task("die")))
        ports[-1].open(lambda _topic, _message: None)
        return list(checks("dexhand_twin", [f"can.port={number}"])), ports[-1]

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


def test_no_adapter_is_one_line_with_advice(capsys):
    overrides = ["--set", "can.interface=pcan", "--set", "plant=hand", "--set", "pose_source=perception"]
    assert doctor.main(["can", "dexhand_twin", *overrides, "--set", "hand_io.auto_arm=false"]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("FAIL  adapter") and "is it plugged in" in line


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

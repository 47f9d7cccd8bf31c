"""Three machines, each with its own address and its own disk, are one cell."""

from pathlib import Path

import pytest

from common.messages import Mode
from common.topics import ACK, HEALTH, STEP
from tests.faults.cell import PATIENCE_S, LiveCell, free_ports, wait

pytestmark = [pytest.mark.processes, pytest.mark.timeout(400)]

EPISODES = 5
ADDRESSES = {"control": "127.0.0.1", "learning": "127.0.0.2", "perception": "127.0.0.3"}
SETS = (
    "warmup_steps=100",
    f"curriculum.episodes={EPISODES}",
    "curriculum.evaluate_goals=0",
    "curriculum.ack_timeout_s=300",  # the learner's machine is started later
)


@pytest.fixture
def machines(tmp_path):
    ports = free_ports(3)
    made = [
        LiveCell(tmp_path / name, ports, config="three_machines", machine=name, sets=SETS)
        for name in ADDRESSES
    ]
    yield made
    for cell in made:
        cell.end()


def dialled_from(port):
    """Local addresses of the established connections to a port of this computer (Linux)."""
    found = set()
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        local, remote, state = line.split()[1:4]
        if state == "01" and int(remote.partition(":")[2], 16) == port:
            octets = bytes.fromhex(local.partition(":")[0])[::-1]
            found.add(".".join(map(str, octets)))
    return found


def test_three_machines_form_one_cell_and_finish_five_episodes(machines):
    control, learning, perception = machines
    control.up()
    starting = [machine.begin("up") for machine in (learning, perception)]
    for process in starting:
        out, _ = process.communicate(timeout=2 * PATIENCE_S)
        assert process.returncode == 0, out
    ear = control.heard
    assert dialled_from(control.port) == set(ADDRESSES.values())
    assert {s.message.config_hash for s in ear.samples(HEALTH)} == {ear.health("sim").config_hash}
    wait(lambda: control.processes()["curriculum"].finished, "the end of the run")
    ends = [s.message for s in ear.samples(STEP) if s.message.last]
    assert [step.mode for step in ends] == [Mode.RANDOM] * 2 + [Mode.PLAN] * EPISODES
    assert {s.message.episode for s in ear.samples(ACK)} == {step.episode for step in ends}
    assert ear.field("viewer", "drawn") > 0
    status = control.do("status")  # all is well, on the other machines too
    assert all(name in status for name in ("planner", "watchdog_learning", "watchdog_perception"))
    assert (learning.run_dir / "learner" / "snapshot.safetensors").exists()
    assert (control.run_dir / "episodes.jsonl").exists()
    assert list(perception.run_dir.glob("*.rrd"))
    for cell in reversed(machines):
        assert "stopped in" in cell.do("down")
        assert cell.alive() == {}

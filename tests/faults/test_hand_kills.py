"""The live cell with the emulated hand, its processes killed: it holds, lets go, and waits for a person."""

import signal
import time

import numpy as np
import pytest

from bench.can import free_port
from common.messages import Fallback, Mode
from common.topics import CHUNK, EPISODE, HAND_JOINTS, STEP
from tests.faults.cell import free_ports, wait
from tests.faults.twin_cell import TwinCell

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

NS_PER_S = 1e9
PERIOD_S = 1 / 3
SILENCE_S = 0.5  # after which the emulated boards let go
SLACK_S = 0.3  # of a busy machine
SETS = (
    "warmup_steps=12",
    "curriculum.episode_steps=40",
    "curriculum.evaluate_goals=0",
    "learner.warmup_updates=20",
    "hand_io.auto_arm=false",
    "emulator.pose_hz=100",  # so that every round of physics is in the log
)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    sets = (*SETS, f"can.port={free_port()}")
    cell = TwinCell(tmp_path_factory.mktemp("twin"), free_ports(3), config="dexhand_twin", sets=sets)
    try:
        cell.up()
        wait(lambda: cell.state == "hold" and cell.arm() == 0, "arming")
        yield cell
    finally:
        cell.end()


def running(cell):
    """A step of a planned episode, just published, a few of them from its beginning."""
    seen = len(cell.heard.samples(STEP))

    def fresh():
        new = cell.heard.samples(STEP)[seen:]
        fit = [s for s in new if s.message.mode is Mode.PLAN and not s.message.waiting and s.message.k >= 3]
        return fit[-1] if fit else None

    return wait(fresh, lambda: f"a planned step; {cell.said()}")


def test_without_its_planner_the_hand_holds_as_soon_as_the_last_plan_is_used_up(cell):
    hit = running(cell)
    killed_s, killed_ns = cell.signal("planner", signal.SIGKILL), time.time_ns()
    episode, ear = hit.message.episode, cell.heard

    def planned_again():  # on a busy machine in the next episode only
        return [s for s in ear.samples(CHUNK, killed_s + 1.0) if s.message.episode >= episode]

    wait(planned_again, lambda: f"new plans; {cell.said()}")
    wait(lambda: ear.steps_of(episode)[-1].message.k >= hit.message.k + 8, "some more steps")
    steps = {sample.message.k: sample for sample in ear.steps_of(episode)}
    began = [s for s in ear.samples(CHUNK) if s.message.episode == episode and s.header.t_ns <= killed_ns]
    planned_until = max(s.message.first_k + s.message.commit for s in began)
    # What was done at k is told with k + 1.
    done = [steps[k + 1].message for k in range(hit.message.k, hit.message.k + 4)]
    fallbacks = {step.k - 1: step.fallback for step in done}
    assert fallbacks == {
        k: Fallback.NONE if k < planned_until else Fallback.HOLD
        for k in range(hit.message.k, hit.message.k + 4)
    }
    waited_s = (steps[planned_until].header.t_ns - killed_ns) / NS_PER_S
    plans_left = planned_until - hit.message.k - 1  # sent before the end, for steps that had not begun
    assert plans_left <= 1 and waited_s < PERIOD_S * (1 + plans_left) + SLACK_S
    assert np.array_equal(done[-1].prev_action, done[-2].prev_action)
    held_ns = steps[planned_until].header.t_ns + round(PERIOD_S * NS_PER_S)
    assert_still(cell, held_ns, held_ns + round(PERIOD_S * NS_PER_S))


def assert_still(cell, begin_ns, end_ns):
    def whole():
        frames = cell.physics(begin_ns)
        return frames if frames and frames[-1].t_ns > end_ns else None

    frames = wait(whole, "the emulator's log")
    angles = np.array([frame.q_rad for frame in frames if frame.t_ns <= end_ns])
    assert len(angles) > 5 and np.ptp(angles, axis=0).max() < 0.03


def test_without_hand_io_the_boards_let_go_and_what_comes_back_waits_for_a_person(cell):
    hit, ear = running(cell), cell.heard
    killed_s, killed_ns = cell.signal("hand_io", signal.SIGKILL), time.time_ns()
    wait(lambda: [s for s in ear.samples(HAND_JOINTS, killed_s + 0.2) if s.message.state == "hold"], "hold")
    back_s = time.monotonic()
    assert ear.boot("hand_io") != hit.header.boot_id
    wait(lambda: time.monotonic() > back_s + 2.0, "two more seconds")
    later = ear.samples(HAND_JOINTS, back_s)
    assert {sample.message.state for sample in later} == {"hold"}  # and stays there
    assert not [s for s in ear.samples(STEP, killed_s + 0.2) if not s.message.waiting]
    frames = cell.physics(killed_ns)
    limp = next(frame for frame in frames if not frame.powered.any())
    assert (limp.t_ns - killed_ns) / NS_PER_S < SILENCE_S + SLACK_S
    assert not any(frame.powered.any() for frame in frames if frame.t_ns > limp.t_ns)
    assert cell.arm() == 0
    again = running(cell)
    assert again.message.episode == hit.message.episode and again.header.boot_id != hit.header.boot_id


def test_no_motor_with_torque_was_ever_told_to_leave_its_range(cell):
    wait(lambda: cell.heard.samples(EPISODE), "an episode")
    frames = cell.physics(0)
    assert len(frames) > 1000 and any(frame.powered.any() for frame in frames)
    # Where the joints are says nothing: the twin cuts what it is told to the range.
    assert frames[-1].counts["beyond_range"] == 0

"""The live cell whose camera is unplugged in mid-episode: told, held, marked, and over when it returns."""

import json
import time

import numpy as np
import pytest

from bench.can import free_port
from common.camera_messages import PoseState
from common.messages import Fallback, Mode
from common.topics import HEALTH, OBJECT_POSE, POSE_TRACKING, STEP
from deploy.curriculum_files import read_rows
from services.sim.camera_service import FAULT_QUERY
from tests.faults.cell import free_ports, wait
from tests.faults.twin_cell import TwinCell

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

SLACK_S = 0.5  # of a busy machine
UNPLUGGED_S = 4.0  # less than the 5 s of holding after which the hand would relax
SETS = (
    "warmup_steps=12",
    "curriculum.episode_steps=40",
    "curriculum.evaluate_goals=0",
    "learner.warmup_updates=20",
)


class CameraCell(TwinCell):
    heard_too = (*TwinCell.heard_too, OBJECT_POSE, POSE_TRACKING)

    def tracking(self, since_s, state):
        """What perception has said in this state since then."""
        said = [sample.message for sample in self.heard.samples(POSE_TRACKING, since_s)]
        return [one for one in said if one.state is state]

    def beaten(self, words, since_s):
        """Whether a heartbeat of perception has had these words since then."""
        beats = [sample.message for sample in self.heard.samples(HEALTH, since_s)]
        return any(words in beat.state for beat in beats if beat.service == "perception")

    def steps(self, since_s):
        """Steps of the hand's own pace since then."""
        return [s.message for s in self.heard.samples(STEP, since_s) if not s.message.waiting]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    sets = (*SETS, f"can.port={free_port()}")
    cell = CameraCell(tmp_path_factory.mktemp("camera"), free_ports(3), config="dexhand_camera", sets=sets)
    try:
        cell.up()
        yield cell
    finally:
        cell.end()


def sees(step):
    return bool(step.part_valid.all())


def planned(cell, since_s, from_k=0):
    """A step that followed a plan, with the die in sight."""

    def found():
        fit = [
            s
            for s in cell.steps(since_s)
            if s.mode is Mode.PLAN and s.k >= from_k and sees(s) and s.fallback is Fallback.NONE
        ]
        return fit[-1] if fit else None

    return wait(found, lambda: f"a planned step; {cell.said()}")


def test_an_unplugged_camera_is_told_the_hand_holds_the_episode_is_marked_and_all_goes_on_after(cell):
    hit = planned(cell, 0.0, from_k=4)
    fault = {"kind": "unplugged", "for_s": UNPLUGGED_S}
    assert cell.heard.bus.ask(FAULT_QUERY, json.dumps(fault).encode(), 5.0) == b""
    pulled_s, pulled_ns = time.monotonic(), time.time_ns()

    suspect = wait(lambda: cell.tracking(pulled_s, PoseState.SUSPECT), lambda: f"suspect; {cell.said()}")
    lost = wait(lambda: cell.tracking(pulled_s, PoseState.LOST), lambda: f"lost; {cell.said()}")
    assert "is the camera unplugged?" in suspect[-1].message
    assert "is the camera unplugged?" in lost[-1].message
    wait(lambda: cell.beaten("lost: no picture", pulled_s), "the state in a heartbeat")

    # What was planned before may still be carried out in the first of them.
    blind = wait(lambda: [s for s in cell.steps(pulled_s) if not sees(s)][2:7], "steps without a pose")
    assert {step.fallback for step in blind} == {Fallback.HOLD}
    assert all(np.array_equal(step.prev_action, blind[0].prev_action) for step in blind)
    assert {step.episode for step in blind} == {hit.episode}

    back = wait(lambda: cell.tracking(pulled_s + UNPLUGGED_S, PoseState.TRACKING), "the die found again")
    assert back[-1].claimed
    again = planned(cell, pulled_s + UNPLUGGED_S, from_k=blind[-1].k + 1)
    assert again.episode == hit.episode
    captured_s = [(s.header.t_ns - pulled_ns) / 1e9 for s in cell.heard.samples(OBJECT_POSE)]
    assert not [at for at in captured_s if SLACK_S < at < UNPLUGGED_S - SLACK_S], "a pose without a picture"

    row = wait(lambda: finished(cell, hit.episode), "the episode's row")
    unseen = sum(not sees(s) for s in cell.steps(0.0) if s.episode == hit.episode and s.k > 0)
    assert row["unseen_steps"] == unseen >= len(blind)


def finished(cell, episode):
    """The row of an episode that has ended."""
    rows = read_rows(cell.run_dir) if (cell.run_dir / "episodes.jsonl").exists() else []
    return next((row for row in rows if row["episode"] == episode), None)

"""Figures of a live run from its bus logs: a made-up run of which every number is known."""

import json

import numpy as np
import pytest
import yaml

from bench.perception import live
from common.built import codec_for
from common.buslog import BusLog, Entry
from common.camera_messages import TwinTruth
from common.hand_messages import ObjectPose, PoseSource
from common.messages import Fallback, Header, Mode, Step
from common.task import get_task
from common.topics import OBJECT_POSE, STEP, TWIN_TRUTH

MS, START = 1_000_000, 10**18
DIE = get_task("die")
QUARTER = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0], np.float32)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)


def step(k, age_ms, valid=1, waiting=False):
    parts = np.ones(len(DIE.groups), np.uint8)
    parts[2:] = valid
    state = np.zeros(DIE.state_dim, np.float32)
    state[20] = 1.0
    ages = np.array([5.0, 5.0, age_ms, age_ms], np.float32)
    action, goal = np.zeros(DIE.action_dim, np.float32), np.zeros(DIE.goal_dim, np.float32)
    ends = k == 0, False, waiting, False
    return Step(1, 0, k, 50, Mode.PLAN, state, parts, ages, action, goal, -1, -1, Fallback.NONE, *ends)


def pose(x_m, rotation=UPRIGHT):
    covariance, labels = np.eye(6, dtype=np.float32), np.eye(24, dtype=np.float32)[0]
    place = np.array([x_m, 0.0, 0.0], np.float32)
    return ObjectPose(place, rotation, covariance, 1.0, labels, PoseSource.PERCEPTION)


@pytest.fixture
def run(tmp_path):
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "hand_io.yaml").write_text(yaml.safe_dump({"cell": "made", "task": "die"}))
    codec, log = codec_for("die"), BusLog(tmp_path / "log", "made", 7, 10**8, 10**9)

    def say(topic, message, at_ms, seen_ms=None, valid=True):
        seen_ns = START + (at_ms if seen_ms is None else seen_ms) * MS
        payload = codec.encode(Header(7, at_ms, seen_ns, valid), message)
        log.write(Entry("out", START + at_ms * MS, topic.key, payload))

    for at_ms in (0, 30, 60):
        say(TWIN_TRUTH, TwinTruth(np.zeros(3, np.float32), UPRIGHT, np.zeros(12, np.float32)), at_ms)
    say(OBJECT_POSE, pose(0.001), 40, seen_ms=0)
    say(OBJECT_POSE, pose(0.002, QUARTER), 90, seen_ms=30)  # claimed, and wrong by 90 degrees
    say(OBJECT_POSE, pose(0.030), 110, seen_ms=60, valid=False)
    say(STEP, step(0, 80.0, waiting=True), 100)
    for k, age_ms in enumerate((80.0, 100.0, 120.0)):
        say(STEP, step(k, age_ms), 200 + 333 * k)
    say(STEP, step(3, 700.0, valid=0), 200 + 3 * 333)
    log.close()
    return tmp_path


def test_ages_and_errors_are_those_of_the_run(run, capsys):
    assert live.main([str(run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["episodes"], found["steps"], found["steps_without_a_pose"]) == (1, 4, 1)
    assert found["step_period_ms_median"] == 333
    assert found["capture_to_use_ms"] == pytest.approx({"p50": 100.0, "p90": 116.0, "p99": 119.6})
    assert found["capture_to_told_ms"]["p50"] == 50
    assert (found["claimed"], found["unclaimed"]) == (2, 1)
    assert (found["gross_claimed"], found["gross_unclaimed"]) == (1, 1)
    assert found["claimed_off_mm"]["p50"] == pytest.approx(1.5)
    assert found["claimed_off_deg"]["p50"] == pytest.approx(45.0)


def test_a_folder_without_steps_is_one_line(tmp_path, capsys):
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "hand_io.yaml").write_text(yaml.safe_dump({"cell": "made", "task": "die"}))
    assert live.main([str(tmp_path)]) == 2
    assert "no control steps; was log.enabled true?" in capsys.readouterr().err

"""Glove demonstrations in lock-step: replayed on the twin within its limits, and a run that begins so."""

import json

import numpy as np
import pytest

from bench.methods import configure
from bench.run import train
from common.built import codec_for
from common.bus import Input, LocalBus
from common.clock import VirtualClock
from common.config import ConfigError
from common.dexhand021.glove_files import read_demonstrations
from common.dexhand021.glove_recording import COLUMNS
from common.dexhand021.tables import HIGH_RAD, JOINTS
from common.lockstep import Lockstep
from common.messages import Episode, Fallback, Mode, Warmup
from common.runner import Dispatcher
from common.service import Finish, Publish, Report
from common.topics import EPISODE, STEP
from deploy.curriculum_files import read_rows
from services.learner.episode import from_bytes
from services.sim.build import SimProcess, build
from services.sim.glove_writers import write_recordings
from tests.unit.common.dexhand021.glove_samples import recording

STEPS = 8
INDEX_MCP = [joint.name for joint in JOINTS].index("ff_mcp")


def calm(rows=181):
    """Three seconds that a hand can follow: all joints in a slow wave, none out of reach."""
    wave = recording(rows)
    wave.angles_deg[:] = (20 + 15 * np.sin(np.arange(rows) / 30))[:, None]
    for name in ("Index", "Ring", "Pinky"):
        wave.angles_deg[:, COLUMNS.index(f"{name}_MCP_Spread")] *= 0.2
    return wave


def sources(tmp_path, *recordings):
    files = write_recordings(tmp_path / "glove", recordings, "csv")
    return {"sources": [{"files": [str(file) for file in files]}]}


class Operator:
    """Asks for one episode and listens to it."""

    name, period_ns, boot_id = "operator", None, 44
    inputs = (Input(STEP, wake=True),)

    def __init__(self, episode):
        self.episode, self.steps, self.asked = episode, [], False

    def step(self, now_ns, inbox):
        self.steps += [sample.message for sample in inbox.take(STEP)]
        if not self.asked:
            self.asked = True
            return [Publish(EPISODE, self.episode)]
        return [Finish()] if self.steps and self.steps[-1].last else []

    def stop(self, now_ns):
        return []

    def report(self):
        return Report("listening")


def played(config, number=0, until_s=60):
    """The steps of one glove episode on the twin, the physics behind it, and the plant's counts."""
    built = build(config, 11)
    episode = Episode(number, 0, np.zeros(0, np.float32), Mode.GLOVE, Warmup.NONE, STEPS, 5)
    operator, bus, codec = Operator(episode), LocalBus(), codec_for("die")
    dispatchers = [
        Dispatcher(operator, codec, bus, {}),
        Dispatcher(built.service, codec, bus, built.ports),
    ]
    dispatchers[0].inbox.wake.set()
    run = Lockstep(dispatchers, VirtualClock())
    run.run(lambda: False, until_s * 10**9)
    run.close()
    return operator.steps, built.ports["plant"]._plant, built.service.report().fields


def process(**glove):
    return SimProcess.model_validate({"task": "die", "control": {"rate_hz": 3.0}, "glove": glove})


def test_the_twin_executes_what_the_glove_recorded_and_says_so(tmp_path):
    config = process(**sources(tmp_path, calm()))
    steps, _, fields = played(config)
    wanted = read_demonstrations(config.glove, 3.0).episode(0, STEPS)
    assert [step.k for step in steps] == list(range(STEPS + 1))
    assert {step.mode for step in steps} == {Mode.GLOVE} and not any(step.waiting for step in steps)
    assert {(step.chunk_seq, step.fallback) for step in steps} == {(-1, Fallback.NONE)}
    assert np.array_equal([step.prev_action for step in steps[1:]], wanted)
    assert [(step.first, step.last) for step in steps][:: len(steps) - 1] == [(True, False), (False, True)]
    assert (fields["warmup_steps"], fields["glove_samples"]) == (STEPS + 1, 10)
    # Slow enough to be followed: at the end of each step the joints are where the hand was.
    reached = np.array([step.state[:12] for step in steps[1:]])
    assert np.abs(reached - (wanted + 1) / 2 * HIGH_RAD)[2:, [0, 1]].max() < 0.1


def test_each_episode_has_its_own_part_of_the_recordings(tmp_path):
    config = process(**sources(tmp_path, calm(), recording(181, "other", seed=3)))
    demonstrations = read_demonstrations(config.glove, 3.0)
    for number in (1, 2):
        steps, _, _ = played(config, number)
        actions = [step.prev_action for step in steps[1:]]
        assert np.array_equal(actions, demonstrations.episode(number, STEPS))


def test_a_bad_value_moves_no_joint_beyond_its_range_or_faster_than_allowed(tmp_path):
    bad = calm()
    bad.angles_deg[40:80, COLUMNS.index("Index_MCP_Flex")] = 179.0  # no finger does that
    bad.angles_deg[100:140, COLUMNS.index("Index_MCP_Flex")] = -179.0
    steps, twin, _ = played(process(**sources(tmp_path, bad)))
    asked = np.array([step.prev_action[INDEX_MCP] for step in steps[1:]])
    assert asked.max() == 1.0 and asked.min() == -1.0
    angles = np.array([step.state[:12] for step in steps])
    assert (angles <= HIGH_RAD + 0.02).all() and (angles >= -0.02).all()
    moved = np.abs(np.diff(angles[:, INDEX_MCP]))
    assert 0.3 < moved.max() <= twin.physics.rate_rad_s / 3 + 0.1


def test_without_recordings_a_glove_episode_is_refused_and_counted():
    steps, _, fields = played(process(), until_s=2)
    assert steps == [] and fields["refused_episodes"] == 1.0


TINY = (
    "warmup_steps=24",
    "model={members: 2, hidden: [16, 16], targets: standardised}",
    "planner.members=2",
    "planner.candidates=8",
    "planner.elites=2",
    "learner.warmup_updates=20",
    "curriculum={episodes: 1, episode_steps: 8, evaluate_goals: 0, warmup: glove}",
)


def test_a_run_begins_with_the_recordings_and_learns_from_them(tmp_path):
    given = sources(tmp_path, calm(161), recording(161, "other", seed=3))
    out = tmp_path / "run"
    cell = configure("die", "gc_pmpc_plus", (*TINY, f"glove={json.dumps(given)}"), out)
    summary = train(cell, "gc_pmpc_plus", out)
    assert [row["mode"] for row in read_rows(out)] == ["glove"] * 3 + ["plan"]
    assert (summary["warmup_steps"], summary["training_episodes"]) == (24, 1)
    stored = [from_bytes(path.read_bytes()) for path in (out / "learner" / "episodes").iterdir()]
    shown = read_demonstrations(cell.glove, 3.0)
    by_glove = {each.episode: each for each in stored if each.mode == "glove"}
    assert sorted(by_glove) == [0, 1, 2]
    for number, each in by_glove.items():
        assert np.array_equal(each.actions, shown.episode(number, STEPS))


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        (
            ["curriculum.warmup=glove"],
            "curriculum.warmup: glove wants recordings: name them in glove.sources",
        ),
        (
            ["task=reach", "glove.sources=[{files: [a.csv]}]"],
            "glove.sources: no glove fits the hand of task reach, the DexHand 021's alone",
        ),
    ],
)
def test_a_glove_where_there_can_be_none_is_refused(tmp_path, overrides, complaint):
    with pytest.raises(ConfigError) as refused:
        configure("die", "gc_pmpc_plus", overrides, tmp_path)
    assert f"die.yaml: {complaint}" in refused.value.lines

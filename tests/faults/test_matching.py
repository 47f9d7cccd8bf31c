"""The same seed in one process on a virtual clock and in many on the wall clock: the same run."""

from dataclasses import astuple

import numpy as np
import pytest

from bench.lockstep_run import assemble
from common.buslog import log_files, read_log
from common.messages import Mode
from common.topics import EPISODE, STEP
from deploy.cell import load_cell, on_this_machine
from tests.faults.cell import STEPS
from tests.faults.conftest import UNTOUCHED
from tests.samples import CODEC

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

WARMUPS, EVALUATIONS = 4, 1
EPISODES = WARMUPS + EVALUATIONS + UNTOUCHED


@pytest.fixture(scope="module")
def virtual(shared, tmp_path_factory):
    """Messages of the lock-step run of the shared cell's configuration, by topic."""
    directory = tmp_path_factory.mktemp("lockstep")
    cell = on_this_machine(load_cell("debug", (*shared.sets, f"run_dir={directory}")))
    run = assemble(cell, log_dir=directory / "log")
    report = run.services["curriculum"].report
    run.lockstep.run(lambda: report().fields["episode"] >= EPISODES, 10**12)
    run.lockstep.close()
    entries = [e for path in log_files(directory / "log") for e in read_log(path) if e.kind == "out"]
    return {
        topic: [CODEC.decode(e.key, e.payload).message for e in entries if e.key == topic.key]
        for topic in (STEP, EPISODE)
    }


def upto(messages):
    return [message for message in messages if message.episode < EPISODES]


@pytest.fixture(scope="module")
def live(shared):
    return {topic: [s.message for s in shared.heard.samples(topic)] for topic in (STEP, EPISODE)}


def test_episodes_are_the_same(virtual, live):
    told, expected = upto(live[EPISODE]), upto(virtual[EPISODE])
    assert len(expected) == EPISODES
    assert [str(astuple(message)) for message in told] == [str(astuple(message)) for message in expected]


def flags(step):
    return (step.episode, step.goal_seq, step.k, step.steps, step.mode, step.first, step.last, step.waiting)


def test_steps_are_the_same(virtual, live):
    steps, expected = upto(live[STEP]), upto(virtual[STEP])
    modes = [step.mode for step in expected if step.last]
    assert modes == [Mode.RANDOM] * WARMUPS + [Mode.EVALUATE] * EVALUATIONS + [Mode.PLAN] * UNTOUCHED
    assert [flags(step) for step in steps] == [flags(step) for step in expected]
    for step, other in zip(steps, expected, strict=True):
        assert np.array_equal(step.goal, other.goal)
        assert np.array_equal(step.part_valid, other.part_valid)


def test_warm_up_and_the_start_of_every_episode_are_the_same_to_the_bit(virtual, live):
    alike = 0
    for step, other in zip(upto(live[STEP]), upto(virtual[STEP]), strict=True):
        if step.mode is Mode.RANDOM or step.k == 0:
            alike += 1
            assert np.array_equal(step.state, other.state)
            assert np.array_equal(step.prev_action, other.prev_action)
    assert alike == WARMUPS * (STEPS + 1) + 2 * (EVALUATIONS + UNTOUCHED)

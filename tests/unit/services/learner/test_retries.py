"""Stores and updates that fail are tried again after a pause; episodes that are unfit are not."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from common.messages import Mode
from common.topics import ACK, METRICS, SNAPSHOT, STEP
from services.learner.service import PERIOD_NS, RETRY_NS
from tests.samples import S, step
from tests.unit.services.learner.driver import LENGTH, Learner, restart, trained


@pytest.fixture
def learner(tmp_path):
    return Learner(tmp_path)


def full(_episode):
    raise OSError("no space left on device")


def broken(_begin=None):
    raise RuntimeError("out of memory")


def test_an_episode_that_the_disk_refuses_is_tried_again_after_a_pause_until_it_is_stored(learner):
    assert learner.service.period_ns == PERIOD_NS == RETRY_NS // 4
    learner.worker.store, keep = full, learner.worker.store
    for number in (0, 1):
        learner.record(number)
    learner.work_all()
    for attempts in (2, 3, 4):
        assert (learner.fields["failed_stores"], learner.fields["unstored_episodes"]) == (attempts, 2)
        assert learner.state == "episode not stored, trying again: OSError: no space left on device"
        learner.wait(RETRY_NS - 1)
        assert learner.queue == deque()
        learner.wait(1)
        assert len(learner.queue) == 1  # the other one waits for what comes of it
        learner.work()
    learner.worker.store = keep
    learner.wait()
    learner.work()
    assert learner.fields["unstored_episodes"] == 0 and len(learner.queue) == 1  # no pause: there is room
    learner.work()
    assert sorted(a.episode for a in learner.all(ACK)) == [0, 1]
    assert (learner.files(), learner.state, learner.job_names[-1]) == (2, "training", "train")
    assert (learner.fields["refused_episodes"], learner.fields["failed_stores"]) == (0, 5)


def test_a_new_episode_that_is_stored_brings_on_those_that_wait_and_what_they_owe(learner):
    trained(learner)
    learner.worker.store, keep = full, learner.worker.store
    learner.record(2, Mode.PLAN)
    learner.work()
    learner.worker.store = keep
    learner.record(3, Mode.PLAN)
    learner.work_all()
    assert [a.episode for a in learner.all(ACK)] == [0, 1, 3, 2]
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 3, 3]
    assert learner.state == "ready"


def test_an_update_goes_on_while_the_disk_refuses_episodes_and_that_stays_the_state(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work()
    learner.worker.store = full
    learner.record(3, Mode.PLAN)
    learner.work_all()
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 2]
    assert learner.state == "episode not stored, trying again: OSError: no space left on device"


def test_an_episode_that_is_unfit_is_counted_shown_and_not_tried_again(learner):
    for k in range(LENGTH + 1):
        message = step(k, episode=0, steps=LENGTH, last=k == LENGTH, mode=Mode.RANDOM)
        learner.send(STEP, replace(message, state=np.full(S, k, np.float32)))
    learner.turn()
    job = learner.queue.popleft()
    (episode,) = job.arguments
    bad = replace(episode, states=np.full_like(episode.states, np.nan))
    learner.queue.append(replace(job, arguments=(bad,)))
    assert learner.work() == []
    learner.wait()
    assert (learner.queue, learner.files(), learner.fields["refused_episodes"]) == (deque(), 0, 1)
    assert learner.state == "episode refused: states is not finite"
    assert (learner.fields["failed_stores"], learner.fields["unstored_episodes"]) == (0, 0)
    learner.record(1)
    learner.work()
    assert learner.state == f"collecting: {LENGTH}/{2 * LENGTH} steps"


@pytest.mark.parametrize("mode", [Mode.RANDOM, Mode.PLAN])
def test_an_update_that_fails_is_shown_and_tried_again_after_a_pause(learner, mode):
    learner.worker.train, keep = broken, learner.worker.train
    trained(learner)
    for attempts in (1, 2, 3):
        assert learner.fields["failed_updates"] == attempts
        assert learner.state == "update failed, trying again: RuntimeError: out of memory"
        learner.wait(RETRY_NS - 1)
        assert learner.queue == deque()  # repeating it at once would keep the machine busy
        learner.wait(1)
        learner.work()
    learner.worker.train = keep
    learner.record(2, mode)
    learner.work_all()
    assert learner.all(METRICS) == []  # stored, and the pause is kept
    learner.wait()
    learner.work_all()
    planned = mode is Mode.PLAN
    assert learner.fields["updates"] == 3 + (5 if planned else 0)
    assert (learner.state, [m.after_episode for m in learner.all(METRICS)]) == (
        "ready",
        [2, 2][: 1 + planned],
    )


def test_an_update_that_fails_half_way_is_begun_anew_without_a_new_episode(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work()  # stored
    learner.work()  # two of five gradient steps
    learner.queue[0] = replace(learner.queue[0], function=broken)
    learner.work()
    assert learner.fields["failed_updates"] == 1
    learner.wait()
    learner.work_all()
    assert learner.fields["updates"] == 3 + 2 + 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 2]


def test_an_announcement_that_fails_is_repeated(learner):
    trained(learner)
    again = restart(learner)
    again.queue[0] = replace(again.queue[0], function=broken)
    again.work()
    again.wait()
    assert again.job_names == ["announce", "announce"]
    assert [output.topic for output in again.work()] == [SNAPSHOT, METRICS]


def test_texts_are_cut(learner):
    def wordy(_episode):
        raise OSError("x" * 1000)

    learner.worker.store = wordy
    learner.record(0)
    learner.work()
    assert learner.state == "episode not stored, trying again: OSError: ".ljust(200, "x")

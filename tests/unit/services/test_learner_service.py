"""The learner's service: what is stored, when it is acknowledged, what is learned from it, and restarts."""

from collections import deque

import numpy as np
import pytest

from common.messages import Mode
from common.model.snapshot import Snapshot
from common.topics import ACK, METRICS, SNAPSHOT, STEP
from services.learner.loss import LossTerms
from services.learner.worker import CHECKPOINT
from tests.samples import PLANT, step
from tests.unit.services.learner.driver import LENGTH, Learner, restart, trained


@pytest.fixture
def learner(tmp_path):
    return Learner(tmp_path)


def test_an_episode_is_acknowledged_only_when_it_is_on_disk(learner):
    learner.record(7)
    assert (learner.job_names, learner.sent, learner.files()) == (["store"], [], 0)
    assert learner.queue[0].latency_ns == 4_000_000
    (told,) = learner.work()
    assert learner.files() == 1
    ack = told.message
    assert (ack.plant_boot_id, ack.episode, ack.stored_episodes, ack.stored_steps) == (PLANT, 7, 1, LENGTH)
    assert learner.state == f"collecting: {LENGTH}/{2 * LENGTH} steps"


def test_the_first_update_begins_when_the_warm_up_is_stored_and_ends_in_snapshot_and_metrics(learner):
    learner.record(0)
    learner.record(1)
    learner.work()
    assert learner.job_names == ["store", "store"]
    learner.work()
    assert learner.job_names == ["store", "store", "train"]
    assert (learner.state, learner.queue[0].latency_ns) == ("training", 20_000_000)
    assert learner.work(duration_ns=3_000_000) == []  # two of three gradient steps
    told = learner.work(duration_ns=1_000_000)
    assert [output.topic for output in told] == [SNAPSHOT, METRICS]  # in this order
    snapshot, metrics = (output.message for output in told)
    assert Snapshot.from_bytes(snapshot.payload).id == snapshot.snapshot_id == metrics.snapshot_id
    assert (snapshot.episodes, metrics.episodes, metrics.steps) == (2, 2, 2 * LENGTH)
    assert (metrics.after_episode, metrics.updates, metrics.update_ms) == (1, 3, 4.0)
    assert set(metrics.loss) >= set(LossTerms._fields)
    assert all(np.isfinite(value) for value in metrics.loss.values())
    assert (learner.state, learner.fields["updates"], learner.queue) == ("ready", 3, deque())


@pytest.mark.parametrize("warmup", [Mode.RANDOM, Mode.GLOVE])
def test_each_planned_episode_owes_an_update_and_random_ones_none(learner, warmup):
    trained(learner)
    learner.record(2, warmup)
    learner.work_all()
    assert learner.fields["updates"] == 3
    learner.record(3, Mode.PLAN)
    learner.work_all()
    assert learner.fields["updates"] == 3 + 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 3]


def test_what_comes_while_training_is_owed_afterwards_an_update_and_a_snapshot_at_a_time(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work()
    assert learner.job_names[-1] == "train"
    for number in (3, 4):
        learner.record(number, Mode.PLAN)
    learner.work_all()
    assert learner.fields["updates"] == 3 + 5 + 5 + 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 2, 4, 4]
    assert [m.updates for m in learner.all(METRICS)] == [3, 8, 13, 18]
    assert (learner.fields["snapshots"], learner.fields["skipped_updates"]) == (4, 0)


def test_a_backlog_beyond_two_updates_is_dropped_and_counted(learner):
    trained(learner)
    for number in range(2, 7):
        learner.record(number, Mode.PLAN)
    while learner.queue:
        assert sum(job.name != "store" for job in learner.queue) <= 1  # never two updates at once
        learner.work()
    # one is asked for when the other four are stored, of which two are kept
    assert learner.fields["updates"] == 3 + 3 * 5
    assert learner.fields["skipped_updates"] == 2 * 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 6, 6, 6]


def test_evaluations_are_neither_stored_nor_acknowledged(learner):
    learner.record(0, Mode.EVALUATE)
    assert (learner.job_names, learner.sent, learner.files()) == ([], [], 0)


def test_an_episode_that_arrives_twice_is_stored_once(learner):
    for _ in range(2):
        learner.record(0)
    learner.work_all()
    assert (learner.files(), len(learner.all(ACK)), learner.fields["stored_episodes"]) == (1, 1, 1)


def test_an_episode_with_a_missing_step_is_not_stored(learner):
    for k in (0, 1, 3, 4, 5):
        learner.send(STEP, step(k, episode=0, steps=5, last=k == 5, mode=Mode.RANDOM))
    learner.turn()
    assert learner.job_names == []
    learner.send(STEP, step(2, episode=0, steps=5, mode=Mode.RANDOM))
    learner.turn()
    assert learner.job_names == ["store"]


def test_what_a_restarted_plant_runs_again_is_acknowledged_to_it_but_counted_and_learned_once(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work_all()
    learned = learner.fields["updates"]
    learner.record(2, Mode.PLAN, boot=PLANT + 1)
    learner.work_all()
    assert [(a.plant_boot_id, a.episode, a.stored_episodes) for a in learner.all(ACK)[-2:]] == [
        (PLANT, 2, 3),
        (PLANT + 1, 2, 3),
    ]
    fields = learner.fields
    assert (learner.files(), fields["stored_episodes"], fields["updates"]) == (3, 3, learned)
    assert fields["repeated_episodes"] == 1


def test_a_first_try_that_broke_off_does_not_keep_the_second_out(learner):
    for k in range(3):
        learner.send(STEP, step(k, episode=0, steps=LENGTH, mode=Mode.RANDOM), PLANT)
    learner.turn()
    learner.record(0, boot=PLANT + 1)
    learner.work_all()
    assert [(a.plant_boot_id, a.episode) for a in learner.all(ACK)] == [(PLANT + 1, 0)]
    assert (learner.files(), learner.fields["repeated_episodes"]) == (1, 0)


def test_a_restarted_learner_announces_at_its_first_step_what_it_knows(learner):
    trained(learner)
    again = restart(learner)
    assert again.job_names == ["announce"]
    assert [(a.episode, a.stored_episodes) for a in again.all(ACK)] == [(0, 2), (1, 2)]
    told = again.work()
    assert [output.topic for output in told] == [SNAPSHOT, METRICS]
    before, after = learner.all(SNAPSHOT)[-1], told[0].message
    old, new = Snapshot.from_bytes(before.payload), Snapshot.from_bytes(after.payload)
    assert all(bool((a == b).all()) for a, b in zip(old.weights, new.weights, strict=True))
    assert (told[1].message.after_episode, told[1].message.updates) == (1, 3)
    assert (again.fields["stored_episodes"], again.state, again.queue) == (2, "ready", deque())


def test_episodes_stored_but_not_trained_on_before_the_restart_are_owed(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work()  # stored, and then the process dies
    again = restart(learner)
    again.work_all()
    assert again.job_names == ["announce", "train", "train", "train"]
    assert (again.fields["updates"], again.all(METRICS)[-1].after_episode) == (5, 2)


def test_what_the_plant_repeats_to_a_restarted_learner_is_acknowledged_but_not_learned_twice(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work_all()
    again = restart(learner)
    again.work_all()
    again.sent.clear()
    again.record(2, Mode.PLAN)
    again.work_all()
    assert [(a.episode, a.stored_episodes) for a in again.all(ACK)] == [(2, 3)]
    assert (again.files(), again.fields["updates"]) == (3, 0)


def test_a_learner_that_restarts_in_its_warm_up_goes_on_collecting(learner):
    learner.record(0)
    learner.work_all()
    again = restart(learner)
    assert (again.job_names, again.state) == ([], f"collecting: {LENGTH}/{2 * LENGTH} steps")
    again.record(1)
    again.work_all()
    assert [m.after_episode for m in again.all(METRICS)] == [1]


def test_an_unusable_checkpoint_is_said_and_training_begins_anew(learner):
    trained(learner)
    checkpoint = learner.directory / "learner" / CHECKPOINT
    checkpoint.write_bytes(checkpoint.read_bytes()[:-10])
    again = restart(learner)
    assert again.state.startswith("checkpoint refused, training from the stored episodes: ")
    assert again.job_names == ["train"]  # the warm-up is on disk
    again.work_all()
    assert (again.state, again.fields["updates"]) == ("ready", 3)


def test_files_that_could_not_be_used_are_reported(learner):
    trained(learner)
    episodes = learner.directory / "learner" / "episodes"
    (episodes / "00000009-1-9.safetensors").write_bytes(b"torn")
    for number in (1, 2):
        (episodes / f".{number}.safetensors.partial").write_bytes(b"half")
    fields = restart(learner).fields
    assert (fields["corrupt_files"], fields["leftover_files"], fields["stored_episodes"]) == (1, 2, 2)


def test_of_what_was_missed_before_a_restart_two_updates_are_made_up_for(learner):
    trained(learner)
    for number in range(2, 6):
        learner.record(number, Mode.PLAN)
    for _ in range(4):
        learner.work()  # stored, and then the process dies
    again = restart(learner)
    again.work_all()
    assert (again.fields["updates"], again.fields["skipped_updates"]) == (2 * 5, 2 * 5)


def test_a_restart_that_finds_fewer_episodes_than_were_learned_from_owes_nothing(learner):
    trained(learner)
    next((learner.directory / "learner" / "episodes").glob("*.safetensors")).unlink()
    again = restart(learner)
    again.work_all()
    assert (again.job_names, again.fields["updates"]) == (["announce"], 0)

"""The learner's service: what is stored, when it is acknowledged, what is learned from it, and restarts."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from common.messages import Mode
from common.model.config import ModelConfig
from common.model.snapshot import Snapshot
from common.runner import run_job
from common.service import Publish
from common.topics import ACK, METRICS, SNAPSHOT, STEP
from services.learner.config import LearnerConfig, LossConfig
from services.learner.dataset import EpisodeStore
from services.learner.loss import LossTerms
from services.learner.service import LearnerService
from services.learner.trainer import Trainer
from services.learner.worker import CHECKPOINT, LearnerWorker
from tests.samples import PLANT, TASK, A, Driver, S, jobs, published, step

LENGTH = 5
MODEL = ModelConfig(members=1, hidden=(4,), train_masks=1, plan_masks=1)
CONFIG = LearnerConfig(
    loss=LossConfig(decay=(0.0, 0.0)),
    batch=4,
    warmup_updates=3,
    updates_per_episode=5,
    slice_updates=2,
    declared_update_ms=10,
    declared_store_ms=4,
)


class Learner(Driver):
    """The service with its worker, which runs one job when it is told to."""

    def __init__(self, directory, warmup_steps=2 * LENGTH):
        (directory / "learner").mkdir(parents=True, exist_ok=True)
        store = EpisodeStore(directory / "learner" / "episodes", S, A)
        self.worker = LearnerWorker(directory / "learner", store, Trainer(CONFIG, MODEL, TASK, 0))
        super().__init__(LearnerService(CONFIG, warmup_steps, self.worker, 33))
        self.directory = directory
        self.queue, self.sent, self.job_names = deque(), [], []
        self.turn()

    def turn(self):
        outputs = self.step()
        self.queue.extend(jobs(outputs))
        self.job_names += [job.name for job in jobs(outputs)]
        self.sent += [output for output in outputs if isinstance(output, Publish)]
        return outputs

    def record(self, number, mode=Mode.RANDOM, boot=PLANT, length=LENGTH):
        """Let the plant run a whole episode of random states."""
        draw = np.random.default_rng((number, boot))
        for k in range(length + 1):
            message = step(k, episode=number, steps=length, last=k == length, mode=mode)
            state = draw.uniform(-0.5, 0.5, S).astype(np.float32)
            action = draw.uniform(-1, 1, A).astype(np.float32)
            self.send(STEP, replace(message, state=state, prev_action=action), boot)
        self.turn()

    def work(self, duration_ns=0):
        """Finish the oldest job; returns what the service then publishes."""
        job = self.queue.popleft()
        self.finish(job, *run_job(job), duration_ns=duration_ns)
        return [o for o in self.turn() if isinstance(o, Publish)]

    def work_all(self):
        while self.queue:
            self.work()

    def all(self, topic):
        return published(self.sent, topic)

    def files(self):
        return len(list((self.directory / "learner" / "episodes").glob("*.safetensors")))

    @property
    def fields(self):
        return self.service.report().fields

    @property
    def state(self):
        return self.service.report().state


@pytest.fixture
def learner(tmp_path):
    return Learner(tmp_path)


def trained(learner):
    """Bring a learner to the end of its first update."""
    learner.record(0)
    learner.record(1)
    learner.work_all()
    return learner


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


def test_each_planned_episode_owes_an_update_and_random_ones_none(learner):
    trained(learner)
    learner.record(2)
    learner.work_all()
    assert learner.fields["updates"] == 3
    learner.record(3, Mode.PLAN)
    learner.work_all()
    assert learner.fields["updates"] == 3 + 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 3]


def test_what_comes_while_training_is_owed_together_afterwards(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work()
    assert learner.job_names[-1] == "train"
    for number in (3, 4):
        learner.record(number, Mode.PLAN)
    learner.work_all()
    assert learner.fields["updates"] == 3 + 5 + 2 * 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 2, 4]
    assert learner.fields["snapshots"] == 3


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


def test_two_plants_may_use_the_same_numbers(learner):
    learner.record(0, boot=PLANT)
    learner.record(0, boot=PLANT + 1)
    learner.work_all()
    assert learner.files() == 2
    assert [(a.plant_boot_id, a.episode) for a in learner.all(ACK)] == [(PLANT, 0), (PLANT + 1, 0)]


def test_an_episode_that_cannot_be_stored_is_counted_shown_and_not_acknowledged(learner):
    def full(_episode):
        raise OSError("no space left on device")

    learner.worker.store, keep = full, learner.worker.store
    learner.record(0)
    assert learner.work() == []
    assert learner.fields["refused_episodes"] == 1
    assert learner.state == "episode not stored: OSError: no space left on device"
    learner.worker.store = keep
    learner.record(1)
    learner.work()
    assert [a.episode for a in learner.all(ACK)] == [1]


@pytest.mark.parametrize("mode", [Mode.RANDOM, Mode.PLAN])
def test_an_update_that_fails_is_shown_and_made_up_for_with_the_next_episode(learner, mode):
    def broken(_begin):
        raise RuntimeError("out of memory")

    learner.worker.train, keep = broken, learner.worker.train
    trained(learner)
    assert learner.fields["failed_updates"] == 1
    assert learner.state == "update failed: RuntimeError: out of memory"
    assert learner.queue == deque()  # repeating it at once would fail for ever
    learner.worker.train = keep
    learner.record(2, mode)
    learner.work_all()
    assert learner.fields["updates"] == 3 + (5 if mode is Mode.PLAN else 0)
    assert (learner.state, [m.after_episode for m in learner.all(METRICS)]) == ("ready", [2])


def test_an_update_that_fails_half_way_is_begun_anew(learner):
    trained(learner)
    learner.record(2, Mode.PLAN)
    learner.work()  # stored
    learner.work()  # two of five gradient steps

    def broken(_begin):
        raise RuntimeError("out of memory")

    learner.queue[0] = replace(learner.queue[0], function=broken)
    learner.work()
    assert learner.fields["failed_updates"] == 1
    learner.record(3, Mode.PLAN)
    learner.work_all()
    assert learner.fields["updates"] == 3 + 2 + 2 * 5
    assert [m.after_episode for m in learner.all(METRICS)] == [1, 3]


def restart(learner):
    return Learner(learner.directory)


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

"""The whole loop in lock-step: it learns and acts, a seed is a run, and nonsense changes nothing."""

import hashlib
import random
from dataclasses import replace

import numpy as np
import pytest
import torch

from common.bus import Input
from common.codec import Refused
from common.messages import Mode
from common.model.snapshot import Snapshot
from common.service import Publish, Report
from common.task import get_task
from common.topics import ACK, CHUNK, METRICS, SNAPSHOT, STEP, TOPICS
from services.planner.config import PlannerConfig
from services.planner.mpc import Mpc
from services.planner.particles import particles
from services.sim.plant import ShadowHandPlant
from tests.contracts.test_codec_fuzz import fuzzed, valid_payloads
from tests.lockstep.world import CODEC, SCRIPT, SECTIONS, World, logs

TASK = get_task("reach")
A = TASK.action_dim


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """A run of the whole script in which nothing goes wrong."""
    return World(tmp_path_factory.mktemp("clean")).run()


def test_episodes_run_are_stored_learned_from_and_planned_with_what_was_learned(clean):
    steps = [sample.message for sample in clean.sent("sim", STEP)]
    ends = [(step.episode, step.mode, step.k) for step in steps if step.last]
    assert ends == [(number, mode, length) for number, (mode, length) in enumerate(SCRIPT)]
    assert [s.message.episode for s in clean.sent("learner", ACK)] == [0, 1, 2, 3]  # not the evaluation
    after = [s.message.after_episode for s in clean.sent("learner", METRICS)]
    assert after == [1, 2, 3]
    ids = [s.message.snapshot_id for s in clean.sent("learner", SNAPSHOT)]
    used = [s.message.snapshot_id for s in clean.sent("planner", CHUNK)]
    assert len(set(ids)) == 3 and sorted(set(used), key=used.index) == ids[: len(set(used))]
    assert len(set(used)) >= 2  # the planner went over to a new model
    assert clean.dispatchers["sim"].inbox.refused == {}


def test_every_planned_action_was_planned_in_time_and_steps_follow_one_another(clean):
    steps = [s.message for s in clean.sent("sim", STEP) if s.message.mode is not Mode.RANDOM]
    chunks = {s.header.seq: s.message for s in clean.sent("planner", CHUNK)}
    moved = [step for step in steps if not step.waiting]
    for step in moved:
        if step.k:
            chunk = chunks[step.chunk_seq]
            assert chunk.episode == step.episode
            assert chunk.first_k + step.chunk_offset == step.k - 1
            assert np.array_equal(chunk.actions[step.chunk_offset], step.prev_action)
    assert [step.k for step in moved] == [*range(11)] * 3
    fields = clean.fields("sim")
    assert (fields["late_steps"], fields["held_steps"], fields["missed_ticks"]) == (0, 0, 0)


def test_the_declared_times_are_the_ones_that_show(clean):
    chunks = clean.sent("planner", CHUNK)
    assert {sample.message.solve_ms for sample in chunks} == {50.0}
    assert {s.header.t_ns - s.message.source_t_ns for s in chunks} == {50_000_000}
    assert {s.message.first_k - s.message.source_k for s in chunks} == {0, 2}
    steps = [s for s in clean.sent("sim", STEP) if s.message.mode is Mode.EVALUATE and not s.message.waiting]
    times = np.array([sample.header.t_ns for sample in steps])
    assert set(np.diff(times)) == {40_000_000}


def test_the_same_seed_gives_the_same_logs_byte_for_byte(clean, tmp_path):
    again = World(tmp_path / "again").run()
    assert len(logs(clean.run_dir)) == 4
    assert logs(again.run_dir) == logs(clean.run_dir)


class Forger:
    """Answers each chunk with four that are for something else."""

    name = "forger"
    inputs = (Input(CHUNK, wake=True),)
    period_ns = None
    boot_id = 66

    def __init__(self):
        self.sent = 0

    def step(self, now_ns, inbox):
        out = []
        for sample in inbox.take(CHUNK):
            if sample.header.boot_id == self.boot_id:
                continue
            good = replace(sample.message, actions=-np.ones_like(sample.message.actions))
            out += [
                Publish(CHUNK, replace(good, plant_boot_id=12)),
                Publish(CHUNK, replace(good, episode=good.episode + 1)),
                Publish(CHUNK, replace(good, goal_seq=1)),
                Publish(CHUNK, replace(good, episode=good.episode - 1)),
            ]
        self.sent += len(out)
        return out

    def stop(self, now_ns):
        return []

    def report(self):
        return Report("forging")


def frames(world, name, topic):
    """What was sent on a topic, with stamps."""
    return [CODEC.encode(sample.header, sample.message) for sample in world.sent(name, topic)]


def test_chunks_for_something_else_are_refused_counted_and_change_nothing(clean, tmp_path):
    forger = Forger()
    world = World(tmp_path / "forged", others=(forger,)).run()
    assert frames(world, "sim", STEP) == frames(clean, "sim", STEP)
    fields = world.fields("sim")
    each = forger.sent / 4
    assert forger.sent > 40 and fields["refused_chunks"] == forger.sent
    assert (fields["refused_other_boot"], fields["refused_other_goal"]) == (each, each)
    assert fields["refused_other_episode"] == 2 * each


def broken_payloads(count):
    """(key, payload) that the codec refuses, on every key."""
    draw = random.Random(1)
    valid = dict(valid_payloads())
    keys = [topic.key.replace("*", "sim") for topic in TOPICS]
    found = []
    while len(found) < count:
        key = keys[len(found) % len(keys)]
        payload = fuzzed(draw, valid.get(key) or draw.choice(list(valid.values())))
        try:
            CODEC.decode(key, payload)
        except Refused:
            found.append((key, payload))
    return found


def test_two_thousand_bad_payloads_change_nothing_and_are_all_counted(clean, tmp_path):
    bad = broken_payloads(2000)
    world = World(tmp_path / "noisy")
    topics = {topic.key.replace("*", "sim"): topic for topic in TOPICS}

    def pester():
        if world.clock.time_ns and bad:  # while planned episodes run
            for key, payload in (bad.pop() for _ in range(min(20, len(bad)))):
                sent[key] += 1
                world.bus.publish(topics[key], key, payload)

    sent = dict.fromkeys(topics, 0)
    world.run(pester)
    assert bad == [] and min(sent.values()) > 100
    assert logs(world.run_dir) == logs(clean.run_dir)
    for dispatcher in world.dispatchers.values():
        heard = {spec.topic.key for spec in dispatcher.service.inputs if spec.topic.key in sent}
        assert dispatcher.inbox.refused == {key: sent[key] for key in heard}


# --- ahead 0 ------------------------------------------------------------------------------------------


def planned_run(directory, steps, **control):
    """One evaluation episode: states, actions, the plans' scores, and the snapshot that made them."""
    world = World(directory, (*SCRIPT[:2], (Mode.EVALUATE, steps)), **control).run()
    (learned,) = (s.message for s in world.sent("learner", SNAPSHOT))
    chunks = [s.message for s in world.sent("planner", CHUNK)]
    assert {chunk.snapshot_id for chunk in chunks} == {learned.snapshot_id}
    told = [s.message for s in world.sent("sim", STEP) if s.message.episode == 2 and not s.message.waiting]
    states, actions = np.array([s.state for s in told]), np.array([s.prev_action for s in told[1:]])
    return states, actions, [chunk.score for chunk in chunks], Snapshot.from_bytes(learned.payload)


class Textbook:
    """The plant and the Mpc of an evaluation episode, without services, bus, buffer or clock."""

    def __init__(self, snapshot: Snapshot, steps: int):
        config = PlannerConfig.model_validate(SECTIONS["planner"]["planner"])
        dynamics = snapshot.dynamics(TASK)
        self.mpc = Mpc(config, TASK)
        self.mpc.set_model(particles(dynamics, snapshot.masks, config.members, config.masks, sampled=False))
        self.plant = ShadowHandPlant("reach")
        self.plant.reset(1003)
        self.steps = steps
        self.states, self.actions, self.scores = [self.plant.state.astype(np.float32)], [], []

    def plan(self, committed):
        """A plan (H, A) from the present state through what is committed (x, A)."""
        k = len(self.actions)
        goal = torch.from_numpy(self.plant.goal.astype(np.float32))
        state, ahead = torch.from_numpy(self.states[-1]), torch.from_numpy(committed)
        random_numbers = generator(0, 2, 0, k + len(committed))
        plan = self.mpc.plan(state, goal, ahead, self.steps - k, random_numbers)
        self.scores.append(plan.score)
        return plan.actions.numpy().clip(-1, 1)

    def execute(self, actions):
        for action in actions[: self.steps - len(self.actions)]:
            self.actions.append(action)
            self.states.append(self.plant.step(action).astype(np.float32))

    def synchronous(self, x):
        """Observe, plan from there, execute x actions, repeat."""
        while len(self.actions) < self.steps:
            self.execute(self.plan(np.empty((0, A), np.float32))[:x])

    def asynchronous(self, x):
        """Sec. III-B: while x actions are executed, plan from the state that they will lead to."""
        committed = self.plan(np.empty((0, A), np.float32))[:x]
        while len(self.actions) < self.steps:
            following = self.plan(committed)[:x] if len(self.actions) + x < self.steps else None
            self.execute(committed)
            committed = following


def generator(*plan):
    """The planner's random numbers depend on seed, episode, goal and first step alone."""
    digest = hashlib.sha256("/".join(map(str, plan)).encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "little") >> 1)


@pytest.mark.parametrize(("x", "chunk"), [(1, "horizon"), (2, "horizon"), (2, "x")])
def test_ahead_0_equals_synchronous_mpc(tmp_path, x, chunk):
    control = {"synchronous": True, "steps_per_plan": x, "chunk": chunk}
    states, actions, scores, snapshot = planned_run(tmp_path / "run", 7, **control)
    expected = Textbook(snapshot, 7)
    expected.synchronous(x)
    assert np.array_equal(actions, expected.actions)
    assert np.array_equal(states, expected.states)
    assert scores == expected.scores


@pytest.mark.parametrize(("x", "solve_ms"), [(1, 30.0), (2, 50.0), (3, 110.0)])
def test_ahead_x_plans_from_where_the_committed_actions_lead(tmp_path, monkeypatch, x, solve_ms):
    monkeypatch.setitem(SECTIONS["planner"]["planner"], "declared_solve_ms", solve_ms)
    states, actions, scores, snapshot = planned_run(tmp_path / "run", 7, steps_per_plan=x)
    expected, synchronous = Textbook(snapshot, 7), Textbook(snapshot, 7)
    expected.asynchronous(x)
    synchronous.synchronous(x)
    assert np.array_equal(actions, expected.actions)
    assert np.array_equal(states, expected.states)
    assert scores == expected.scores
    assert np.array_equal(actions[:x], synchronous.actions[:x])  # the first plan is for the waiting step
    assert scores[1:] != synchronous.scores[1:]  # later plans start from predictions, not from what came

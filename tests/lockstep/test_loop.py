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
    assert bad == [] and min(sent.values()) > 200
    assert logs(world.run_dir) == logs(clean.run_dir)
    for dispatcher in world.dispatchers.values():
        heard = {spec.topic.key for spec in dispatcher.service.inputs if spec.topic.key in sent}
        assert dispatcher.inbox.refused == {key: sent[key] for key in heard}


# --- ahead 0 ------------------------------------------------------------------------------------------


def planned_run(directory, steps, **control):
    """States and actions of one evaluation episode, and the snapshot that it was planned with."""
    world = World(directory, (*SCRIPT[:2], (Mode.EVALUATE, steps)), **control).run()
    (learned,) = (s.message for s in world.sent("learner", SNAPSHOT))
    assert {s.message.snapshot_id for s in world.sent("planner", CHUNK)} == {learned.snapshot_id}
    told = [s.message for s in world.sent("sim", STEP) if s.message.episode == 2 and not s.message.waiting]
    states = np.array([step.state for step in told])
    return states, np.array([step.prev_action for step in told[1:]]), Snapshot.from_bytes(learned.payload)


def textbook(snapshot: Snapshot, steps: int, x: int):
    """Synchronous MPC: observe, plan from there, execute x actions, repeat."""
    config = PlannerConfig.model_validate(SECTIONS["planner"]["planner"])
    dynamics = snapshot.dynamics("reach", TASK.state_dim, A, [])
    mpc = Mpc(config, TASK)
    mpc.set_model(particles(dynamics, snapshot.masks, config.members, config.masks, sampled=False))
    plant = ShadowHandPlant("reach")
    plant.reset(1003)
    goal = torch.from_numpy(plant.goal.astype(np.float32))
    states, actions = [plant.state.astype(np.float32)], []
    for k in range(0, steps, x):
        state = torch.from_numpy(states[-1])
        plan = mpc.plan(state, goal, torch.empty(0, A), steps - k, generator(0, 2, 0, k))
        for action in plan.actions[: min(x, steps - k)].numpy().clip(-1, 1):
            states.append(plant.step(action).astype(np.float32))
            actions.append(action)
    return np.array(states), np.array(actions)


def generator(*plan):
    """The planner's random numbers depend on seed, episode, goal and first step alone."""
    digest = hashlib.sha256("/".join(map(str, plan)).encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "little") >> 1)


@pytest.mark.parametrize(("x", "chunk"), [(1, "horizon"), (2, "horizon"), (2, "x")])
def test_ahead_0_equals_synchronous_mpc(tmp_path, x, chunk):
    control = {"synchronous": True, "steps_per_plan": x, "chunk": chunk}
    states, actions, snapshot = planned_run(tmp_path / "run", 7, **control)
    expected_states, expected_actions = textbook(snapshot, 7, x)
    assert np.array_equal(actions, expected_actions)
    assert np.array_equal(states, expected_states)


def test_asynchronous_mpc_is_not_the_same_thing(tmp_path):
    _, actions, snapshot = planned_run(tmp_path / "run", 7)
    _, expected = textbook(snapshot, 7, 2)
    assert np.array_equal(actions[:2], expected[:2])  # the first plan starts from the waiting step
    assert not np.array_equal(actions[2:], expected[2:])

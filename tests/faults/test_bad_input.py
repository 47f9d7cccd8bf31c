"""Ten thousand bad payloads on every key of a cell at work: none is taken for a message, all are counted."""

import random
import time
from collections import Counter
from dataclasses import replace

import msgpack
import numpy as np
import pytest
import torch
import zenoh

from common.bus_config import BusConfig
from common.codec import Refused
from common.messages import VERSION, Header, Mode, SnapshotMessage
from common.model.snapshot import Snapshot
from common.topics import (
    ACK,
    CAMERA_PREVIEW,
    CHUNK,
    EPISODE,
    HAND_JOINTS,
    HEALTH,
    METRICS,
    OBJECT_POSE,
    POSE_TRACKING,
    SNAPSHOT,
    STEP,
    TWIN_TRUTH,
)
from common.zenoh_bus import ZenohBus
from common.zenoh_router import open_session
from deploy.curriculum import CurriculumService
from deploy.viewer.service import ViewerService
from deploy.watchdog import Watchdog
from services.learner.service import LearnerService
from services.planner.service import PlannerService
from services.sim.service import SimService
from tests.faults.cell import STEPS, acknowledged, stored, wait
from tests.samples import CODEC, HEALTH_0, METRICS_0, ack, chunk, episode, snapshot, step

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

TOTAL = 10_000
A_SECOND = 1000  # payloads
STRANGERS = 300  # names below health/
SNAPSHOT_EVERY = 20  # larger, and of those that come too fast the receiver keeps the newest only
READERS = {
    "sim": SimService,
    "planner": PlannerService,
    "learner": LearnerService,
    "curriculum": CurriculumService,
    "viewer": ViewerService,
    "watchdog": Watchdog,
}
VALID = {  # what is read in this cell
    STEP: step(),
    CHUNK: chunk(),
    EPISODE: episode(),
    ACK: ack(3),
    METRICS: METRICS_0,
    SNAPSHOT: snapshot(),
    HEALTH: HEALTH_0,
}
TOPICS = tuple(VALID)


def envelope_of(topic):
    return msgpack.unpackb(CODEC.encode(Header(5, 6, 7, True), VALID[topic]))


def noise(draw, _topic):
    return draw.randbytes(draw.randrange(200))


def truncated(draw, topic):
    payload = msgpack.packb(envelope_of(topic))
    return payload[: draw.randrange(len(payload))]


def oversized(draw, topic):
    """Beyond the topic's limit; or with a text beyond it, where the limit is too far away to be tried."""
    envelope = envelope_of(topic)
    if topic is SNAPSHOT:
        envelope["body"]["snapshot_id"] = "x" * 5000
        return msgpack.packb(envelope)
    return msgpack.packb(envelope).ljust(topic.max_bytes + 1 + draw.randrange(100), b"\0")


def with_nan(draw, topic):
    """One field of the body, or one element of an array, is not a number."""
    envelope = envelope_of(topic)
    body = envelope["body"]
    field = draw.choice(sorted(body))
    value = body[field]
    if isinstance(value, list) and value and value[0] == "<f4":
        data = np.frombuffer(value[2], "<f4").copy() if value[2] else np.zeros(15, "<f4")
        data[draw.randrange(len(data))] = draw.choice([np.nan, np.inf, -np.inf])
        body[field] = ["<f4", value[1] if value[2] else [15], data.tobytes()]
    else:
        body[field] = float("nan")
    return msgpack.packb(envelope)


def other_version(draw, topic):
    wrong = draw.choice([0, VERSION + 1, -1, "1", None, 1.0, True])
    return msgpack.packb(envelope_of(topic) | {"v": wrong})


KINDS = (noise, truncated, with_nan, other_version)
OVERSIZED_EACH = 20


def bad_payloads():
    """(topic, key, payload), every kind on every topic, in random order."""
    draw = random.Random(2)
    others = [topic for topic in TOPICS if topic is not SNAPSHOT]
    made = [(topic, oversized(draw, topic)) for topic in TOPICS for _ in range(OVERSIZED_EACH)]
    for i in range(TOTAL - len(made)):
        topic = SNAPSHOT if i % SNAPSHOT_EVERY == 0 else others[i % len(others)]
        made.append((topic, KINDS[(i // SNAPSHOT_EVERY + i // len(others)) % len(KINDS)](draw, topic)))
    draw.shuffle(made)
    for i, (topic, payload) in enumerate(made):
        yield topic, topic.key.replace("*", f"stranger{i % STRANGERS}"), payload


def test_all_of_them_are_bad_and_every_topic_with_a_reader_is_there():
    read = {spec.topic for service in READERS.values() for spec in service.inputs}
    # The viewer also reads what only a driven hand, its twin and a camera send: no part of this cell.
    elsewhere = {HAND_JOINTS, OBJECT_POSE, CAMERA_PREVIEW, POSE_TRACKING, TWIN_TRUTH}
    assert {topic for topic in read if not topic.key.startswith("port/")} == {*TOPICS, *elsewhere}
    kinds = Counter()
    for topic, key, payload in bad_payloads():
        kinds[topic] += 1
        with pytest.raises(Refused):
            CODEC.decode(key, payload)
    assert sum(kinds.values()) == TOTAL
    assert min(kinds[topic] for topic in TOPICS) > 400


def refused(ear):
    """Payloads that each process says it has refused, per topic."""
    counts = Counter()
    for name in READERS:
        for key, count in ear.health(name).refused.items():
            counts[name, key] += count
    return counts


def assert_undisturbed(cell, first):
    """Since episode `first`: one followed the other, each was run, stored and planned as it should be."""
    ear = cell.heard
    wait(lambda: ear.newest(STEP).message.episode > first + 1, "the next episodes")
    assert {s.message.service for s in ear.samples(HEALTH)} == set(READERS)
    told = [s for s in ear.samples(EPISODE) if s.message.episode >= first]
    assert [s.message.episode for s in told] == list(range(first, first + len(told)))
    assert {s.header.boot_id for s in told} == {ear.boot("curriculum")}
    for number in range(first, told[-1].message.episode):
        steps = [s.message for s in ear.steps_of(number)]
        assert [each.k for each in steps] == list(range(STEPS + 1)), number
        assert all(each.mode is Mode.PLAN and each.goal_seq == 0 for each in steps)
    learned = {s.message.snapshot_id for s in ear.samples(METRICS)}
    assert {s.message.snapshot_id for s in ear.samples(CHUNK)} <= learned
    assert acknowledged(ear) <= stored(cell.run_dir)


DISTURBANCES = (
    ("sim", "refused_chunks"),
    ("sim", "refused_episodes"),
    ("sim", "abandoned_episodes"),
    ("planner", "failed_plans"),
    ("learner", "refused_episodes"),
    ("learner", "incomplete_episodes"),
    ("learner", "failed_updates"),
    ("curriculum", "lost_episodes"),
)


def disturbances(ear):
    return {(name, field): ear.field(name, field) for name, field in DISTURBANCES}


def test_ten_thousand_bad_payloads_change_nothing_and_are_all_counted(cell):
    ear, pids, before = cell.heard, cell.pids(), refused(cell.heard)
    disturbed = disturbances(ear)
    sent = Counter()
    first, begin = cell.mid_episode().episode, time.monotonic()
    session = open_session(BusConfig(connect=(f"tcp/127.0.0.1:{cell.port}",)))
    publishers = {}
    for topic, key, payload in bad_payloads():
        if key not in publishers:
            publishers[key] = session.declare_publisher(
                f"debug/{key}", congestion_control=zenoh.CongestionControl.BLOCK
            )
        publishers[key].put(payload)
        sent[topic] += 1
        time.sleep(max(0.0, begin + sum(sent.values()) / A_SECOND - time.monotonic()))
    expected = {
        (name, spec.topic.key): sent[spec.topic]
        for name, service in READERS.items()
        for spec in service.inputs
        if spec.topic in TOPICS
    }
    took = time.monotonic() - begin
    wait(lambda: refused(ear) - before == expected, lambda: f"{expected}: {refused(ear) - before}", 30)
    session.close()
    print(f"{sum(sent.values())} payloads in {took:.1f} s")
    assert cell.pids() == pids
    assert_undisturbed(cell, first)
    assert disturbances(ear) == disturbed


def foreign_snapshots(real):
    """What the codec lets pass, for it is bytes, but no planner may plan with."""
    good = Snapshot.from_bytes(real)
    flipped = bytearray(real)
    flipped[-5] ^= 1
    yield "no safetensors", random.Random(3).randbytes(1000)
    yield "empty", b""
    yield "truncated", real[: len(real) // 2]
    yield "a flipped bit", bytes(flipped)
    yield "another task", replace(good, meta=good.meta.model_copy(update={"task": "egg"})).to_bytes()
    yield "other dimensions", replace(good, meta=good.meta.model_copy(update={"state_dim": 7})).to_bytes()
    yield "another version", replace(good, meta=good.meta.model_copy(update={"version": 9})).to_bytes()
    nan = (torch.full_like(good.weights[0], torch.nan), *good.weights[1:])
    yield "weights that are no numbers", replace(good, weights=nan).to_bytes()


def test_snapshots_of_garbage_are_refused_by_the_planner_and_counted(cell):
    ear, pids = cell.heard, cell.pids()
    first = cell.mid_episode().episode
    bus = ZenohBus(BusConfig(connect=(f"tcp/127.0.0.1:{cell.port}",)), "debug", "forger")
    real = (cell.run_dir / "learner" / "snapshot.safetensors").read_bytes()
    for number, (what, payload) in enumerate(foreign_snapshots(real)):
        count = ear.field("planner", "refused_snapshots")
        message = SnapshotMessage(f"forged {number}", 1, payload)
        bus.publish(SNAPSHOT, SNAPSHOT.key, CODEC.encode(Header(66, number, 0, True), message))
        wait(lambda c=count: ear.field("planner", "refused_snapshots") == c + 1, f"refusal: {what}")
    bus.close()
    assert cell.pids() == pids
    assert_undisturbed(cell, first)

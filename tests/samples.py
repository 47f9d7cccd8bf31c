"""Valid messages to start from, and a driver that steps one service by hand."""

from collections import Counter
from dataclasses import replace

import numpy as np

from common.built import codec_for
from common.bus import Inbox, JobResult
from common.messages import (
    Ack,
    Chunk,
    Episode,
    Fallback,
    Header,
    Health,
    Metrics,
    Mode,
    PlantCommand,
    PlantFrame,
    SnapshotMessage,
    Step,
    Warmup,
)
from common.service import Job, Publish, ToPort
from common.task import get_task

TASK = get_task("reach")
CODEC = codec_for("reach")
S, A, G, V = TASK.state_dim, TASK.action_dim, TASK.goal_dim, len(TASK.groups)
PLANT, PLANNER, LEARNER, OPERATOR = 11, 22, 33, 44  # boot ids

STEP_0 = Step(
    episode=3,
    goal_seq=0,
    k=0,
    steps=10,
    mode=Mode.PLAN,
    state=np.linspace(-0.4, 0.4, S, dtype=np.float32),
    part_valid=np.ones(V, np.uint8),
    part_age_ms=np.zeros(V, np.float32),
    prev_action=np.zeros(A, np.float32),
    goal=np.full(G, 0.25, np.float32),
    chunk_seq=-1,
    chunk_offset=-1,
    fallback=Fallback.NONE,
    first=True,
    last=False,
    waiting=False,
    dropped=False,
)
CHUNK_0 = Chunk(
    plant_boot_id=PLANT,
    episode=3,
    goal_seq=0,
    first_k=0,
    commit=2,
    actions=np.full((5, A), 0.5, np.float32),
    source_k=0,
    source_t_ns=0,
    predicted_k=2,
    predicted_state=np.zeros(S, np.float32),
    predicted_std=np.zeros(S, np.float32),
    score=-1.0,
    snapshot_id="abc",
    solve_ms=10.0,
)
EPISODE_0 = Episode(
    episode=3,
    goal_seq=0,
    goal=np.zeros(0, np.float32),
    mode=Mode.PLAN,
    warmup=Warmup.NONE,
    steps=10,
    seed=7,
)
FRAME_0 = PlantFrame(
    state=np.full(S, 0.1, np.float32), goal=np.full(G, 0.25, np.float32), dropped=False, reset=True
)

HEALTH_0 = Health("sim", "ok", 1.0, 2.0, 3, 4, ("a",), {"b": 1}, {"c": 2}, "hash", "1", 50.0, {"d": 1.0})
METRICS_0 = Metrics(-1, 1, 2, 3, "abc", 4.0, {"nll": 1.0}, {}, {})


def step(k=0, **changes):
    """The step k of an episode of ten, with a prev_action that tells which it is."""
    prev = np.full(A, k / 16, np.float32)
    return replace(STEP_0, **({"k": k, "first": k == 0, "last": k == 10, "prev_action": prev} | changes))


def chunk(first_k=0, values=(0.5,) * 5, **changes):
    """A chunk whose action i repeats `values[i]`."""
    actions = np.repeat(np.array(values, np.float32)[:, None], A, axis=1)
    return replace(CHUNK_0, **({"first_k": first_k, "actions": actions} | changes))


def episode(number=3, **changes):
    return replace(EPISODE_0, episode=number, **changes)


def ack(number, boot=PLANT):
    return Ack(boot, number, 1, 10)


def snapshot(payload=b"weights"):
    return SnapshotMessage("abc", 1, payload)


def frame(value=0.1, reset=False, **changes):
    return replace(FRAME_0, state=np.full(S, value, np.float32), reset=reset, **changes)


def command(outputs):
    """The plant commands among outputs."""
    found = [output.message for output in outputs if isinstance(output, ToPort)]
    assert all(isinstance(message, PlantCommand) for message in found)
    return found


def published(outputs, topic):
    return [output.message for output in outputs if isinstance(output, Publish) and output.topic is topic]


def jobs(outputs):
    return [output for output in outputs if isinstance(output, Job)]


class Driver:
    """Steps a service with what it is given, through a real inbox and the real codec."""

    def __init__(self, service):
        self.service = service
        self.inbox = Inbox(CODEC, service.inputs)
        self.now_ns = 0
        self._seq = Counter()

    def send(self, topic, message, boot=PLANT, seq=None, t_ns=0):
        number = self._seq[topic.key, boot] if seq is None else seq
        self._seq[topic.key, boot] = number + 1
        self.inbox.sink(topic)(topic.key, CODEC.encode(Header(boot, number, t_ns, True), message))

    def finish(self, job, value=None, error="", duration_ns=0):
        self.inbox.finish(JobResult(job.name, value, error, duration_ns))

    def step(self, ticks=0):
        self.now_ns += 40_000_000 * ticks
        self.inbox.collect(self.now_ns, ticks)
        return self.service.step(self.now_ns, self.inbox)

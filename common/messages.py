"""Every message on the bus and at a port: frozen dataclasses with shape, unit and frame per field.

Letters in shapes: S state, A action, G goal, T steps of a chunk, V parts (groups) of the state; one letter
means one length within a message, and S, A, G, V are fixed by the cell's task. Arrays are float32 unless said
otherwise. Times are int64 nanoseconds. Actions travel normalised to [-1, 1]; the plant maps them to radians.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

from common.camera_messages import (
    CameraFrame,
    CameraPreview,
    PoseReset,
    PoseResetReply,
    PoseTracking,
    TwinTruth,
)
from common.hand_messages import (
    ArmReply,
    ArmRequest,
    HandCommand,
    HandFrame,
    HandJoints,
    ObjectPose,
    TwinCommand,
    TwinFrame,
)
from common.message_fields import ArraySpec, BootId, Count, Float32, Range, UInt8

VERSION = 1


class Mode(StrEnum):
    """How an episode's actions are chosen: warm-up noise, the planner, a glove recording, or not at all."""

    RANDOM = "random"
    PLAN = "plan"
    GLOVE = "glove"
    EVALUATE = "evaluate"  # planned, never stored for learning
    IDLE = "idle"  # nothing to do: the run has ended


WARMUP_MODES = (Mode.RANDOM, Mode.GLOVE)  # before there is a model: no planner, no update after each


class Warmup(StrEnum):
    """Distribution of random actions: iid uniform (the paper's) or joints held for random durations."""

    NONE = "none"
    UNIFORM = "uniform"
    MIX = "mix"


class Fallback(StrEnum):
    """What replaced a planned action; warm-up actions replace none."""

    NONE = "none"
    START = "start"  # the x zero actions that `start: zero` prescribes
    HOLD = "hold"  # nothing left in the buffer: last command repeated
    RELAX = "relax"  # held for too long: zero action


@dataclass(frozen=True)
class Header:
    """Envelope of every message; the runner writes it, services only read it."""

    boot_id: BootId  # the sender's; changes at every start of its process
    seq: Count  # per sender and key
    t_ns: Count  # capture time, ns since the epoch on the sender's clock (virtual time in lock-step)
    valid: bool


@dataclass(frozen=True)
class Step:
    """`control/step`: what the plant saw at step k of an episode and what it executed before it.

    k runs from 0 to `steps`; the message of k = `steps` has `last` set and closes the episode. `prev_action`
    is the action executed between k-1 and k (zeros at k = 0). With `waiting` set the plant stands still and
    wants a chunk that covers k; the same k follows without it once the plant moves.
    """

    episode: Count
    goal_seq: Count
    k: Count
    steps: Count  # control steps of this episode
    mode: Mode
    state: Annotated[Float32, ArraySpec("<f4", ("S",), "task groups: rad, rad/s, m, m/s, quaternion wxyz")]
    part_valid: Annotated[UInt8, ArraySpec("|u1", ("V",), "0 or 1 per group of the state", limit=1)]
    part_age_ms: Annotated[Float32, ArraySpec("<f4", ("V",), "ms from measuring a group to this step")]
    prev_action: Annotated[Float32, ArraySpec("<f4", ("A",), "normalised, as executed", limit=1.0)]
    goal: Annotated[Float32, ArraySpec("<f4", ("G",), "task goal: m, quaternion wxyz")]
    chunk_seq: Annotated[int, Range(-1, 2**62)]  # header.seq of the chunk prev_action came from; -1: none
    chunk_offset: Annotated[int, Range(-1, 4096)]  # its index within that chunk; -1: none
    fallback: Fallback
    first: bool
    last: bool
    waiting: bool
    dropped: bool  # the object left the hand


@dataclass(frozen=True)
class Chunk:
    """`control/chunk`: actions for steps first_k, first_k+1, ... planned from the state of step source_k.

    The first `commit` (the paper's x) are meant to be executed; the rest is the tail that a late planner
    runs down. Any mismatch of plant boot, episode or goal makes the plant refuse the chunk.
    """

    plant_boot_id: BootId
    episode: Count
    goal_seq: Count
    first_k: Count
    commit: Annotated[int, Range(1, 4096)]
    actions: Annotated[Float32, ArraySpec("<f4", ("T", "A"), "normalised", limit=1.0)]
    source_k: Count
    source_t_ns: Count  # the plant's own stamp of that step, echoed: age without clock sync
    predicted_k: Count
    predicted_state: Annotated[Float32, ArraySpec("<f4", ("S",), "task groups, at step predicted_k")]
    predicted_std: Annotated[Float32, ArraySpec("<f4", ("S",), "one deviation over the particles")]
    score: float  # Eq. (5) of the chosen sequence
    snapshot_id: str
    solve_ms: Annotated[float, Range(0, 1e7, "ms")]


@dataclass(frozen=True)
class Episode:
    """`task/episode`: the episode to run now. The same id with goal_seq + 1 changes the goal on the way."""

    episode: Count
    goal_seq: Count
    goal: Annotated[Float32, ArraySpec("<f4", ("D",), "task goal, or empty: the plant draws one from seed")]
    mode: Mode
    warmup: Warmup
    steps: Annotated[int, Range(0, 100_000)]
    seed: Count


@dataclass(frozen=True)
class Ack:
    """`learn/ack`: the named episode is on disk (fsync) and will survive any crash."""

    plant_boot_id: BootId  # when the try ran; the episode alone says what is safe
    episode: Count
    stored_episodes: Count
    stored_steps: Count


@dataclass(frozen=True)
class SnapshotMessage:
    """`model/snapshot`: one safetensors file holding weights, normaliser and digest together."""

    snapshot_id: str
    episodes: Count  # training episodes that the weights have seen
    payload: bytes


@dataclass(frozen=True)
class Metrics:
    """`learn/metrics`: after an update; the maps hold the loss terms, hold-out errors and calibration."""

    after_episode: Annotated[int, Range(-1, 2**62)]  # newest stored episode that this update has seen
    episodes: Count
    steps: Count
    updates: Count
    snapshot_id: str
    update_ms: Annotated[float, Range(0, 1e9, "ms")]
    loss: dict[str, float]
    holdout: dict[str, float]  # RMSE per group and horizon, `<group>_h<h>` in the group's unit
    calibration: dict[str, float]  # actual RMSE / predicted deviation per group; 1 is honest


@dataclass(frozen=True)
class Health:
    """`health/<service>`: sent by the main loop twice a second: it works, not merely exists."""

    service: str
    state: str  # a few words for people
    loop_p50_ms: Annotated[float, Range(0, 1e9, "ms")]
    loop_p99_ms: Annotated[float, Range(0, 1e9, "ms")]
    ticks: Count
    overruns: Count  # ticks skipped because the loop was late
    stale_inputs: tuple[str, ...]
    refused: dict[str, int]  # per topic: payloads that the codec refused
    dropped: dict[str, int]  # per topic: frames lost before they were read
    config_hash: str
    version: str
    rss_mb: Annotated[float, Range(0, 1e9, "MB")]
    fields: dict[str, float] = field(default_factory=dict[str, float])  # what the service counts itself


@dataclass(frozen=True)
class PlantCommand:
    """`port/plant/command`: reset with a seed (and a goal, if not empty), change the goal, or act."""

    reset: bool
    seed: Count
    goal: Annotated[Float32, ArraySpec("<f4", ("D",), "task goal, or empty")]
    action: Annotated[Float32, ArraySpec("<f4", ("E",), "normalised, or empty", limit=1.0)]


@dataclass(frozen=True)
class PlantFrame:
    """`port/plant`: the simulated plant's answer to a command."""

    state: Annotated[Float32, ArraySpec("<f4", ("S",), "task groups")]
    goal: Annotated[Float32, ArraySpec("<f4", ("G",), "task goal")]
    dropped: bool
    reset: bool


BusMessage = Step | Chunk | Episode | Ack | SnapshotMessage | Metrics | Health | ObjectPose | HandJoints
PortMessage = PlantCommand | PlantFrame | HandCommand | HandFrame | ArmRequest | ArmReply
TwinMessage = TwinCommand | TwinFrame | TwinTruth
CameraMessage = CameraFrame | CameraPreview | PoseTracking | PoseReset | PoseResetReply
Message = BusMessage | PortMessage | TwinMessage | CameraMessage


@dataclass(frozen=True)
class Sample:
    """A decoded message with its envelope and the key it came on (without the cell's prefix)."""

    key: str
    header: Header
    message: Any

"""Every message on the bus and at a port: frozen dataclasses with shape, unit and frame per field.

Letters in shapes: S state, A action, G goal, T steps of a chunk, V parts (groups) of the state; one letter
means one length within a message, and S, A, G, V are fixed by the cell's task. Arrays are float32 unless said
otherwise. Times are int64 nanoseconds. Actions travel normalised to [-1, 1]; the plant maps them to radians.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

VERSION = 1

Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]


@dataclass(frozen=True)
class ArraySpec:
    """What the codec demands of an array: little-endian dtype, shape letters or numbers, unit, bounds."""

    dtype: str
    shape: tuple[str | int, ...]
    unit: str
    limit: float = 1e6  # largest accepted magnitude; non-finite values are always refused


@dataclass(frozen=True)
class Range:
    """Closed interval that the codec demands of a number."""

    low: float
    high: float
    unit: str = ""


Count = Annotated[int, Range(0, 2**62)]
BootId = Annotated[int, Range(1, 2**62)]


class Mode(StrEnum):
    """How an episode's actions are chosen: warm-up noise, the planner, a glove recording, or not at all."""

    RANDOM = "random"
    PLAN = "plan"
    GLOVE = "glove"
    EVALUATE = "evaluate"  # planned, never stored for learning
    IDLE = "idle"  # nothing to do: the run has ended


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

    plant_boot_id: BootId
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


class PoseSource(StrEnum):
    """Who tells where the object is; exactly one in a cell."""

    TWIN = "twin"  # the physics behind the emulated hand
    CAMERA = "camera"


@dataclass(frozen=True)
class ObjectPose:
    """`object/pose`: the die in the palm frame; the header's t_ns is when it was seen, not when it was sent."""

    position: Annotated[Float32, ArraySpec("<f4", (3,), "m, palm frame")]
    rotation: Annotated[Float32, ArraySpec("<f4", (4,), "quaternion wxyz, palm frame", limit=2.0)]
    covariance: Annotated[Float32, ArraySpec("<f4", (6, 6), "m² and rad², translation first")]
    quality: Annotated[float, Range(0, 1)]  # share of what should be seen that is
    label_posterior: Annotated[Float32, ArraySpec("<f4", (24,), "probability per labelling", limit=1.0)]
    source: PoseSource


class Drive(StrEnum):
    """What the driver of the hand makes the motors do."""

    OFF = "off"  # no torque; the hand only reports
    HOLD = "hold"  # stay at the present set point
    FOLLOW = "follow"  # go to the commanded action


class Link(StrEnum):
    """Whether the hand's bus can be used."""

    DOWN = "down"
    UP = "up"
    BUS_OFF = "bus_off"  # until a board has been heard again


@dataclass(frozen=True)
class HandCommand:
    """`port/hand/command`: what the driver does until the next command; its own silence ends in no torque."""

    drive: Drive
    action: Annotated[Float32, ArraySpec("<f4", ("E",), "normalised, or empty", limit=1.0)]
    duration_ns: Count  # of the way to `action`


_MOTORS = ("<f4", (12,))


@dataclass(frozen=True)
class HandFrame:
    """`port/hand`: what the hand last reported and what the driver last sent.

    12 motors, 6 boards, 5 fingertips (thumb first) in the order of common.dexhand021.tables; what is not
    valid keeps its last value, or 0 before there was one.
    """

    t_ns: Count  # when this was put together; board i was heard `age_ms[i]` before
    link: Link
    drive: Drive
    angle_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad")]
    target_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad, as sent")]
    enabled: Annotated[UInt8, ArraySpec("|u1", (12,), "motor has torque", limit=1)]
    limited: Annotated[UInt8, ArraySpec("|u1", (12,), "target is not what was asked for", limit=1)]
    current_ma: Annotated[Float32, ArraySpec(*_MOTORS, "mA")]
    flags: Annotated[UInt8, ArraySpec("|u1", (12,), "error bits of a motor")]
    force_n: Annotated[Float32, ArraySpec("<f4", (5,), "N, normal force")]
    force_valid: Annotated[UInt8, ArraySpec("|u1", (5,), "0 or 1", limit=1)]
    temperature_c: Annotated[Float32, ArraySpec("<f4", (6,), "°C")]
    temperature_valid: Annotated[UInt8, ArraySpec("|u1", (6,), "0 or 1", limit=1)]
    age_ms: Annotated[Float32, ArraySpec("<f4", (6,), "ms since a board was heard; 1e6: never")]
    rate_hz: Annotated[Float32, ArraySpec("<f4", (6,), "replies a second")]
    overheated: Annotated[UInt8, ArraySpec("|u1", (6,), "board said so and is not cool again", limit=1)]
    counts: dict[str, float]  # what the driver and the limits count


@dataclass(frozen=True)
class HandJoints:
    """`hand/joints`: a real hand for people; shapes and order as in HandFrame."""

    state: str  # of the arming
    faults: tuple[str, ...]
    q_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad")]
    target_rad: Annotated[Float32, ArraySpec(*_MOTORS, "rad, as sent")]
    current_ma: Annotated[Float32, ArraySpec(*_MOTORS, "mA")]
    flags: Annotated[UInt8, ArraySpec("|u1", (12,), "error bits of a motor")]
    force_n: Annotated[Float32, ArraySpec("<f4", (5,), "N, normal force")]
    force_valid: Annotated[UInt8, ArraySpec("|u1", (5,), "0 or 1", limit=1)]
    temperature_c: Annotated[Float32, ArraySpec("<f4", (6,), "°C")]
    temperature_valid: Annotated[UInt8, ArraySpec("|u1", (6,), "0 or 1", limit=1)]
    board_age_ms: Annotated[Float32, ArraySpec("<f4", (6,), "ms since a board was heard")]


class ArmWish(StrEnum):
    """What a person may ask of a real hand."""

    ARM = "arm"
    DISARM = "disarm"
    STATUS = "status"


@dataclass(frozen=True)
class ArmRequest:
    """`port/arm`: a person's wish, as it came in with the query `hand/arm`."""

    wish: ArmWish


@dataclass(frozen=True)
class ArmReply:
    """`port/arm/reply`: the answer to that query."""

    accepted: bool
    state: str
    reason: str


BusMessage = Step | Chunk | Episode | Ack | SnapshotMessage | Metrics | Health | ObjectPose | HandJoints
PortMessage = PlantCommand | PlantFrame | HandCommand | HandFrame | ArmRequest | ArmReply
Message = BusMessage | PortMessage


@dataclass(frozen=True)
class Sample:
    """A decoded message with its envelope and the key it came on (without the cell's prefix)."""

    key: str
    header: Header
    message: Any

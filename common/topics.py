"""THE table of topics: key, message, nominal rate, delivery, and whether it is logged."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from common import camera_messages, hand_messages, messages
from common.messages import Message


class Priority(Enum):
    """Zenoh priority classes that are in use."""

    REAL_TIME = "real_time"
    DATA = "data"
    BACKGROUND = "background"


@dataclass(frozen=True)
class Topic:
    """One row of the table: what travels on a key and how it is delivered."""

    key: str  # a final `*` stands for the sender's name
    message: type[Message]
    about: str
    rate_hz: float | None = None  # nominal while an episode runs; None: on events
    priority: Priority = Priority.DATA
    block: bool = False  # congestion: wait for the link (own sender thread) instead of dropping
    latched: int = 0  # samples kept by the sender for those who join late or lost some
    recovered: bool = False  # receivers ask again for samples they missed
    ring: int = 0  # samples that may wait for a receiver before the oldest gives way; 0: many
    logged: bool = True
    max_bytes: int = 64 * 1024


STEP = Topic(
    "control/step",
    messages.Step,
    "state, goal and executed action, per control step",
    rate_hz=25.0,
    priority=Priority.REAL_TIME,
    latched=256,
    recovered=True,
)
CHUNK = Topic(
    "control/chunk",
    messages.Chunk,
    "planned actions by step index",
    priority=Priority.REAL_TIME,
)
EPISODE = Topic("task/episode", messages.Episode, "what to do now", latched=1, recovered=True)
ACK = Topic("learn/ack", messages.Ack, "episode is on disk", latched=16, recovered=True)
METRICS = Topic("learn/metrics", messages.Metrics, "losses, hold-out error, calibration", latched=1)
SNAPSHOT = Topic(
    "model/snapshot",
    messages.SnapshotMessage,
    "ensemble weights and normaliser",
    priority=Priority.BACKGROUND,
    block=True,
    latched=1,
    # Few, as only the newest matter; but bad ones, refused behind this queue, must not push out a good one.
    ring=64,
    max_bytes=256 * 1024 * 1024,
)
HEALTH = Topic("health/*", messages.Health, "heartbeat of a main loop", rate_hz=2.0, latched=1)
OBJECT_POSE = Topic("object/pose", hand_messages.ObjectPose, "the die in the palm frame", rate_hz=30.0)
HAND_JOINTS = Topic("hand/joints", hand_messages.HandJoints, "a real hand, joint by joint, for the dashboard")
CAMERA_FRAME = Topic(
    "camera/frame",
    camera_messages.CameraFrame,
    "colour and depth of an emulated hand's camera",
    priority=Priority.BACKGROUND,
    ring=2,
    logged=False,  # 1.5 MB each: recordings of frames have a format of their own
    max_bytes=16 * 1024 * 1024,
)
CAMERA_PREVIEW = Topic(
    "camera/preview",
    camera_messages.CameraPreview,
    "what perception sees, for the dashboard",
    priority=Priority.BACKGROUND,
    ring=2,
    logged=False,
    max_bytes=1024 * 1024,
)
POSE_TRACKING = Topic("object/tracking", camera_messages.PoseTracking, "how perception is doing")
TWIN_TRUTH = Topic("twin/truth", camera_messages.TwinTruth, "where an emulated hand and its die really are")

TOPICS: tuple[Topic, ...] = (
    STEP,
    CHUNK,
    EPISODE,
    ACK,
    METRICS,
    SNAPSHOT,
    HEALTH,
    OBJECT_POSE,
    HAND_JOINTS,
    CAMERA_FRAME,
    CAMERA_PREVIEW,
    POSE_TRACKING,
    TWIN_TRUTH,
)

# Ports are private to a runner; they stand here because their frames are logged and replayed alike.
PLANT_COMMAND = Topic("port/plant/command", messages.PlantCommand, "to the simulated hand")
PLANT_FRAME = Topic("port/plant", messages.PlantFrame, "from the simulated hand")
HAND_COMMAND = Topic("port/hand/command", hand_messages.HandCommand, "to the driver of the real hand")
HAND_FRAME = Topic("port/hand", hand_messages.HandFrame, "from the driver of the real hand")
ARM_REQUEST = Topic("port/arm", hand_messages.ArmRequest, "a person's wish, from the query hand/arm")
ARM_REPLY = Topic("port/arm/reply", hand_messages.ArmReply, "the answer to that query")
TWIN_COMMAND = Topic("port/twin/command", hand_messages.TwinCommand, "to the physics behind emulated boards")
TWIN_FRAME = Topic("port/twin", hand_messages.TwinFrame, "from the physics behind emulated boards")
RESET_REQUEST = Topic("port/reset", camera_messages.PoseReset, "a person's wish, from the query pose/reset")
RESET_REPLY = Topic("port/reset/reply", camera_messages.PoseResetReply, "the answer to that query")
PORTS: tuple[Topic, ...] = (
    PLANT_COMMAND,
    PLANT_FRAME,
    HAND_COMMAND,
    HAND_FRAME,
    ARM_REQUEST,
    ARM_REPLY,
    TWIN_COMMAND,
    TWIN_FRAME,
    RESET_REQUEST,
    RESET_REPLY,
)


def topic_of(key: str) -> Topic:
    """Find the row of a concrete key such as `health/planner`. Raises KeyError for an unknown key."""
    for topic in (*TOPICS, *PORTS):
        if topic.key == key or (topic.key.endswith("/*") and key.startswith(topic.key[:-1])):
            return topic
    raise KeyError(key)

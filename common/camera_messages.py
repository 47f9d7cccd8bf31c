"""Messages of camera and perception; see `common.messages`. Letters: Y rows and X columns of a picture."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from common.message_fields import ArraySpec, Count, Float32, Float64, Range, UInt8, UInt16


@dataclass(frozen=True)
class CameraFrame:
    """`camera/frame`: colour and depth on one pixel grid; conventions as in services.perception.frames."""

    colour: Annotated[UInt8, ArraySpec("|u1", ("Y", "X", 3), "RGB", limit=255)]
    depth: Annotated[UInt16, ArraySpec("<u2", ("Y", "X"), "in units of depth_unit_m, 0: none")]
    depth_unit_m: Annotated[float, Range(1e-6, 0.1, "m")]
    camera_matrix: Annotated[Float64, ArraySpec("<f8", (3, 3), "px: fx 0 cx, 0 fy cy, 0 0 1")]
    colour_time_ns: Count
    depth_time_ns: Count
    frame_number: Count


@dataclass(frozen=True)
class CameraPreview:
    """`camera/preview`: what perception sees, for people; the header's t_ns is when it was captured."""

    colour_jpeg: bytes  # with the die as it is believed to lie
    depth_jpeg: bytes  # nearer is brighter, black: none


class PoseState(StrEnum):
    """How far a pose of the die can be trusted."""

    SEARCHING = "searching"  # no pose yet
    TRACKING = "tracking"
    SUSPECT = "suspect"  # followed, but what is seen contradicts the pose or says too little
    LOST = "lost"  # had one; searching again


@dataclass(frozen=True)
class PoseTracking:
    """`object/tracking`: how perception is doing, with each frame and whenever that changes."""

    state: PoseState
    message: str  # what is wrong and what to do; empty: nothing
    claimed: bool  # a pose was published with this frame that may be learned from
    quality: Annotated[Float32, ArraySpec("<f4", (4,), "consistent, occluded, violated, pip correlation")]
    label_posterior: Annotated[Float32, ArraySpec("<f4", (24,), "probability per labelling", limit=1.0)]
    frame_number: Count
    latency_ms: Annotated[float, Range(0, 1e7, "ms")]  # from capture to now; 0 without a frame
    solve_ms: Annotated[float, Range(0, 1e7, "ms")]  # of the backend


@dataclass(frozen=True)
class TwinTruth:
    """`twin/truth`: where hand and die of an emulated hand really are; for its camera and for comparison."""

    position: Annotated[Float32, ArraySpec("<f4", (3,), "m, of the die, palm frame")]
    rotation: Annotated[Float32, ArraySpec("<f4", (4,), "quaternion wxyz, palm frame", limit=2.0)]
    q_rad: Annotated[Float32, ArraySpec("<f4", (12,), "rad, joints")]


@dataclass(frozen=True)
class PoseReset:
    """`port/reset`: a person's wish that perception forgets the die and searches anew."""

    wanted: bool


@dataclass(frozen=True)
class PoseResetReply:
    """`port/reset/reply`: the answer to that query."""

    accepted: bool
    state: str
    reason: str

"""What a camera sees: one aligned colour and depth picture with its intrinsics and capture times.

Conventions of all of perception. Camera frame: OpenCV optical (x right, y down, z forward), metres, origin in
the colour camera. `T_camera_die` (4, 4) maps the frame of common.die to it. Pixel (u, v) = (column, row),
its centre at whole numbers; u = fx·X/Z + cx. Colour is RGB. Times are int64 ns on the runner's clock.

Letters: H rows, W columns.
"""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.camera_messages import CameraFrame

Float64 = NDArray[np.float64]

MAX_SKEW_NS = 8_000_000  # at 100 deg/s, 10 ms between colour and depth are 1 deg of error
_PINHOLE_ZEROS = (1, 0, 2, 2), (0, 1, 0, 1)  # rows and columns of K that must be 0


@dataclass(frozen=True)
class Frame:
    """Colour and depth on one pixel grid, that of the colour camera.

    Depth stays as the sensor counts it, not in float metres: it is lossless, half the size on the bus and on
    disk, and a tracker converts only the pixels that it reads. 0 means no reading.
    Raises ValueError for wrong shapes or types; whether the picture makes sense is not judged here.
    """

    colour: NDArray[np.uint8]  # (H, W, 3) RGB
    depth: NDArray[np.uint16]  # (H, W), along the optical axis, in units of `depth_unit_m`
    depth_unit_m: float
    camera_matrix: Float64  # (3, 3): fx 0 cx, 0 fy cy, 0 0 1; no lens distortion
    colour_time_ns: int  # middle of the exposure, or as near to it as the source knows
    depth_time_ns: int
    frame_number: int  # counts frames of this source; a gap is a frame that was lost

    def __post_init__(self) -> None:
        """Refuse what has another shape or type."""
        rows_columns = self.depth.shape
        if self.depth.dtype != np.uint16 or len(rows_columns) != 2:
            raise ValueError(f"depth must be (H, W) uint16, got {self.depth.shape} {self.depth.dtype}")
        if self.colour.dtype != np.uint8 or self.colour.shape != (*rows_columns, 3):
            raise ValueError(
                f"colour must be {(*rows_columns, 3)} uint8 like depth, "
                f"got {self.colour.shape} {self.colour.dtype}"
            )
        if not 0.0 < self.depth_unit_m < 0.1:
            raise ValueError(f"depth_unit_m must be in (0, 0.1), got {self.depth_unit_m}")
        check_camera_matrix(self.camera_matrix)

    @property
    def t_ns(self) -> int:
        """Capture time of a pose found in this frame: between both pictures."""
        return (self.colour_time_ns + self.depth_time_ns) // 2

    @property
    def skew_ns(self) -> int:
        """How much later colour was captured than depth."""
        return self.colour_time_ns - self.depth_time_ns

    def depth_m(self) -> NDArray[np.float32]:
        """The whole depth picture (H, W) in metres; 0 where there is no reading."""
        return self.depth * np.float32(self.depth_unit_m)


def frame_of(message: CameraFrame) -> Frame:
    """What a message carries. Raises ValueError, as Frame does."""
    return Frame(
        message.colour,
        message.depth,
        message.depth_unit_m,
        message.camera_matrix,
        message.colour_time_ns,
        message.depth_time_ns,
        message.frame_number,
    )


class Refusal(StrEnum):
    """Why a source has no frame to give."""

    TIMEOUT = "timeout"  # nothing came within the time allowed
    ENDED = "ended"  # a recording is over; nothing will ever come
    INCOMPLETE = "incomplete"  # a set lacks colour or depth
    SKEW = "skew"  # colour and depth are further apart than MAX_SKEW_NS
    BACKWARDS = "backwards"  # not later than the frame before
    INVALID = "invalid"  # shapes, types or intrinsics are not those of a frame


@dataclass(frozen=True)
class Refused:
    """No frame this time: `reason` to count, `message` for people."""

    reason: Refusal
    message: str


class FrameSource(Protocol):
    """A camera, or what stands in for one."""

    def read(self, timeout_s: float) -> Frame | Refused:
        """The next frame, waiting for it at most so long. Never raises for what the device sends."""
        ...

    def close(self) -> None:
        """Let go of the device or file; may be called twice."""
        ...


def check_camera_matrix(matrix: Float64) -> None:
    """Raise ValueError unless `matrix` (3, 3) is a pinhole camera's."""
    if matrix.shape != (3, 3) or matrix.dtype != np.float64 or not np.isfinite(matrix).all():
        raise ValueError(f"camera_matrix must be (3, 3) finite float64, got {matrix.shape} {matrix.dtype}")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or matrix[2, 2] != 1 or matrix[_PINHOLE_ZEROS].any():
        raise ValueError(f"camera_matrix must be (fx 0 cx, 0 fy cy, 0 0 1), got {matrix.tolist()}")


def check_order(frame: Frame, before: Frame | None, max_skew_ns: int = MAX_SKEW_NS) -> Refused | None:
    """Refuse colour and depth that do not belong together, and time that does not go on."""
    if abs(frame.skew_ns) > max_skew_ns:
        message = f"frame {frame.frame_number}: colour is {frame.skew_ns / 1e6:+.1f} ms from depth"
        return Refused(Refusal.SKEW, f"{message}, more than {max_skew_ns / 1e6:.0f} ms: dropped")
    if (
        before is not None
        and min(frame.colour_time_ns - before.colour_time_ns, frame.depth_time_ns - before.depth_time_ns) <= 0
    ):
        message = f"frame {frame.frame_number} was not captured after frame {before.frame_number}: dropped"
        return Refused(Refusal.BACKWARDS, message)
    return None

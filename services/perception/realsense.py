"""Intel RealSense cameras through pyrealsense2 (extra `realsense`): live, and recordings of their SDK.

Depth is mapped onto the colour camera's pixels by the SDK. None of its filters is used: the temporal one lags
behind a moving die, and hole filling invents bridges from finger to die.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.perception.frames import MAX_SKEW_NS, Frame, Refusal, Refused, check_order

log = logging.getLogger(__name__)

# Beyond this a lens coefficient moves a pixel of the middle of the picture by more than a tenth.
_MUCH_DISTORTION = 0.05


@dataclass(frozen=True)
class Stream:
    """Where framesets come from: the SDK's pipeline or syncer, and what ends it."""

    queue: Any  # has try_wait_for_frames(ms)
    stop: Callable[[], None]
    ended: Callable[[], bool]
    live: bool  # capture times are brought to this machine's clock


class RealsenseSource:
    """A camera of the SDK as a source of frames."""

    def __init__(self, stream: Stream, max_skew_ns: int = MAX_SKEW_NS) -> None:
        """Raises ImportError without the extra `realsense`."""
        self._rs: Any = sdk()
        self._stream: Stream | None = stream
        self._max_skew_ns = max_skew_ns
        self._align: Any = self._rs.align(self._rs.stream.color)
        self._offset_ns: int | None = None
        self._before: Frame | None = None
        self._camera: tuple[Any, NDArray[np.float64]] | None = None

    def read(self, timeout_s: float) -> Frame | Refused:
        """The next frame whose colour and depth were captured together."""
        if self._stream is None:
            return Refused(Refusal.ENDED, "the camera has been closed")
        try:
            arrived, frameset = self._stream.queue.try_wait_for_frames(max(1, round(1e3 * timeout_s)))
            if not arrived:
                return self._nothing(timeout_s)
            frame = self._frame(frameset)
        except RuntimeError as error:  # the SDK's only exception; also when the cable is pulled
            return Refused(Refusal.TIMEOUT, f"RealSense: {error}")
        except ValueError as error:
            return Refused(Refusal.INVALID, f"RealSense: {error}")
        if isinstance(frame, Refused):
            return frame
        refused = check_order(frame, self._before, self._max_skew_ns)
        self._before = self._before if refused else frame
        return refused or frame

    def close(self) -> None:
        """Stop streaming; may be called twice."""
        if self._stream is not None:
            self._stream.stop()
            self._stream = None

    def _nothing(self, timeout_s: float) -> Refused:
        if self._stream is not None and self._stream.ended():
            return Refused(Refusal.ENDED, "the recording is over")
        return Refused(Refusal.TIMEOUT, f"no picture within {timeout_s:g} s: is the camera plugged in?")

    def _frame(self, frameset: Any) -> Frame | Refused:
        """Both pictures of a set, depth on colour's pixels."""
        depth, colour = frameset.get_depth_frame(), frameset.get_color_frame()
        if not depth or not colour:
            missing = "depth" if not depth else "colour"
            return Refused(Refusal.INCOMPLETE, f"a set of pictures came without {missing}: dropped")
        if colour.get_profile().format() != self._rs.format.rgb8:
            return Refused(Refusal.INVALID, f"colour is {colour.get_profile().format()}, rgb8 is needed")
        aligned = self._align.process(frameset).get_depth_frame()
        return Frame(
            np.array(colour.get_data(), np.uint8),
            np.array(aligned.get_data(), np.uint16),
            float(depth.get_units()),
            self._camera_matrix(colour.get_profile()),
            self._time_ns(colour),
            self._time_ns(depth),
            int(colour.get_frame_number()),
        )

    def _camera_matrix(self, profile: Any) -> NDArray[np.float64]:
        """K (3, 3) of the colour camera, told once a stream."""
        if self._camera is None or self._camera[0] != profile.unique_id():
            lens = profile.as_video_stream_profile().intrinsics
            if max(map(abs, lens.coeffs)) > _MUCH_DISTORTION:
                log.warning("lens distortion %s of the colour camera is not modelled", list(lens.coeffs))
            matrix = np.array([[lens.fx, 0.0, lens.ppx], [0.0, lens.fy, lens.ppy], [0.0, 0.0, 1.0]])
            self._camera = profile.unique_id(), matrix
        return self._camera[1]

    def _time_ns(self, picture: Any) -> int:
        """Capture time; a device's own clock is brought to this machine's by the shortest delay seen."""
        stamp_ns = round(1e6 * picture.get_timestamp())
        own_clock = picture.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock
        if self._stream is None or not self._stream.live or not own_clock:
            return stamp_ns
        delay_ns = time.time_ns() - stamp_ns
        self._offset_ns = delay_ns if self._offset_ns is None else min(self._offset_ns, delay_ns)
        return stamp_ns + self._offset_ns


def live(serial: str | None = None, width: int = 640, height: int = 480, rate_hz: int = 60) -> Stream:
    """A connected camera, the first one unless `serial` says which. Raises RuntimeError if there is none."""
    rs = sdk()
    pipeline, config = rs.pipeline(), rs.config()
    if serial:
        config.enable_device(serial)
    config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate_hz)
    config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate_hz)
    device = pipeline.start(config).get_device()
    for sensor in device.query_sensors():
        if sensor.supports(rs.option.global_time_enabled):
            sensor.set_option(rs.option.global_time_enabled, 1)
    return Stream(pipeline, pipeline.stop, lambda: False, live=True)


def playback(path: Path) -> Stream:
    """A recording of the SDK (.bag, .db3), frame by frame, once. Raises RuntimeError if it cannot be read."""
    rs = sdk()
    pipeline, config = rs.pipeline(), rs.config()
    config.enable_device_from_file(str(path), repeat_playback=False)
    player = pipeline.start(config).get_device().as_playback()
    player.set_real_time(False)
    over = rs.playback_status.stopped
    return Stream(pipeline, pipeline.stop, lambda: player.current_status() == over, live=False)


def sdk() -> Any:
    """The SDK's module. Raises ImportError saying what to install."""
    try:
        import pyrealsense2
    except ImportError as error:
        hint = "pip install 'gc-pmpc[realsense]' and sudo apt-get install libusb-1.0-0"
        raise ImportError(f"no RealSense SDK ({error}): {hint}") from error
    return pyrealsense2

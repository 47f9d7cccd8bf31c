"""Which pictures are looked at: those of the calibrated camera, in order, alive, with depth in them."""

# pyright: strict

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable
from enum import StrEnum

import numpy as np
from pydantic import Field

from common.config import Frozen
from services.perception.frames import Float64, Frame, check_order

NS_PER_MS = 1e6
_STRIDE = 8  # of the pixels that are looked at: 4800 of a picture of 640 x 480


class ScreenConfig(Frozen):
    """What makes a picture unfit."""

    min_depth_share: float = Field(
        default=0.05, ge=0.0, le=1.0, description="pixels with depth; fewer: covered, too near, or no emitter"
    )
    max_age_ms: float = Field(default=1000.0, gt=0.0, description="from capture to arrival")
    max_ahead_ms: float = Field(default=100.0, ge=0.0, description="a capture time in the future")


class Fault(StrEnum):
    """What is wrong with a picture."""

    ORDER = "order"  # time runs backwards, or colour and depth do not belong together
    AGE = "age"
    STUCK = "stuck"  # the same picture again
    NO_DEPTH = "no_depth"
    CAMERA = "camera"  # another K or size than calibrated


class Screen:
    """Judges one picture after another; `counts` has how many were refused, by fault.

    `misfit` tells what is wrong with a K (3, 3), as Calibration.misfit does.
    """

    def __init__(self, config: ScreenConfig, misfit: Callable[[Float64], str]) -> None:
        self._config = config
        self._misfit = misfit
        self._before: Frame | None = None
        self._print = 0  # of the newest picture that K, order and age let pass
        self._seen = False
        self.counts: Counter[Fault] = Counter()

    def judge(self, now_ns: int, frame: Frame) -> str:
        """What is wrong with a picture and what to do, in a line; empty if it is fit."""
        fault = self._fault(now_ns, frame)
        if fault is None:
            self._before = frame
            return ""
        self.counts[fault[0]] += 1
        return fault[1]

    def _fault(self, now_ns: int, frame: Frame) -> tuple[Fault, str] | None:
        misfit = self._misfit(frame.camera_matrix)
        if misfit:
            return Fault.CAMERA, misfit
        order = check_order(frame, self._before)
        if order is not None:
            return Fault.ORDER, order.message
        return self._aged(now_ns, frame) or self._stuck(frame) or self._blind(frame)

    def _aged(self, now_ns: int, frame: Frame) -> tuple[Fault, str] | None:
        age_ms = (now_ns - frame.t_ns) / NS_PER_MS
        if -self._config.max_ahead_ms <= age_ms <= self._config.max_age_ms:
            return None
        when = f"{age_ms / 1e3:.1f} s old" if age_ms > 0 else f"from {-age_ms / 1e3:.1f} s ahead"
        return Fault.AGE, f"picture is {when}: do the clocks of camera and perception agree?"

    def _stuck(self, frame: Frame) -> tuple[Fault, str] | None:
        sample = frame.colour[::_STRIDE, ::_STRIDE], frame.depth[::_STRIDE, ::_STRIDE]
        before, self._print = self._print, zlib.crc32(sample[1].tobytes(), zlib.crc32(sample[0].tobytes()))
        repeated = self._seen and before == self._print  # a live sensor's noise is never the same twice
        self._seen = True
        if not repeated:
            return None
        return (
            Fault.STUCK,
            "the camera gives the same picture again and again: unplug it, or restart its driver",
        )

    def _blind(self, frame: Frame) -> tuple[Fault, str] | None:
        share = float(np.mean(frame.depth[::_STRIDE, ::_STRIDE] > 0))
        if share >= self._config.min_depth_share:
            return None
        return Fault.NO_DEPTH, f"depth in {share:.0%} of the picture: is the lens covered or the emitter off?"

"""The emulated hand's camera as a service: a picture of each truth that comes, as fast as it can be drawn."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum

import numpy as np
from pydantic import Field, ValidationError

from common.bus import Inbox, Input
from common.camera_config import CameraConfig
from common.camera_messages import CameraFrame, TwinTruth
from common.config import ConfigError, Frozen, parse
from common.service import Job, Output, Publish, Report
from common.topics import CAMERA_FRAME, TWIN_TRUTH

FAULT_QUERY = "camera/fault"
NS_PER_S = 1e9
Draw = Callable[[TwinTruth, int, int], CameraFrame]


class CameraFaultKind(StrEnum):
    """What can go wrong with a camera."""

    UNPLUGGED = "unplugged"  # no pictures
    STUCK = "stuck"  # the same picture again and again
    NO_DEPTH = "no_depth"
    SWAPPED = "swapped"  # blue, green, red


class CameraFault(Frozen):
    """One fault, for `for_s` from when it was told of."""

    kind: CameraFaultKind
    for_s: float = Field(default=1.0, gt=0.0, le=3600.0)


class CameraFaults:
    """Told by queries, on any thread; asked by the service."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._told: list[CameraFault] = []
        self._until_ns: dict[CameraFaultKind, int] = {}

    def answer_query(self, payload: bytes) -> bytes:
        """Take a fault as JSON; the answer is empty, or says what is wrong with it."""
        try:
            fault = parse(CameraFault, json.loads(payload), "fault")
        except (ConfigError, ValueError, TypeError, ValidationError) as error:
            return str(error).encode()
        with self._lock:
            self._told.append(fault)
        return b""

    def on(self, now_ns: int) -> set[CameraFaultKind]:
        """Those that last at a time."""
        with self._lock:
            told, self._told = self._told, []
        for fault in told:
            self._until_ns[fault.kind] = now_ns + round(fault.for_s * NS_PER_S)
        return {kind for kind, until_ns in self._until_ns.items() if now_ns < until_ns}


class CameraService:
    """Draws in a worker, one picture at a time; of truths that come meanwhile the newest is drawn next."""

    name = "camera"
    inputs = (Input(TWIN_TRUTH, newest=True, wake=True),)
    period_ns: int | None = None

    def __init__(self, config: CameraConfig, draw: Draw, faults: CameraFaults, boot_id: int) -> None:
        self.boot_id = boot_id
        self._draw, self._faults = draw, faults
        self._period_ns = NS_PER_S / config.rate_hz
        self._waiting: tuple[TwinTruth, int] | None = None
        self._drawing = False
        self._due_ns = 0.0  # when the next picture may be taken
        self._number = 0
        self._last: CameraFrame | None = None
        self._draw_ms = 0.0
        self._counts: Counter[str] = Counter()
        self._error = ""

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Send what is drawn, and draw the newest truth."""
        out: list[Output] = []
        for result in inbox.results:
            self._drawing = False
            self._error = result.error
            if isinstance(result.value, CameraFrame):
                self._draw_ms = result.duration_ns / 1e6
                out += self._sent(now_ns, result.value)
        for sample in inbox.take(TWIN_TRUTH):
            self._waiting = sample.message, sample.header.t_ns
        if self._waiting is None or self._drawing or self._waiting[1] < self._due_ns:
            return out
        (truth, t_ns), self._waiting = self._waiting, None
        # A little early is in time: truths come at a rate of their own.
        self._due_ns = max(self._due_ns + self._period_ns, t_ns + 0.5 * self._period_ns)
        self._drawing = True
        self._number += 1
        return [*out, Job("draw", self._draw, (truth, t_ns, self._number), lane="draw")]

    def _sent(self, now_ns: int, frame: CameraFrame) -> list[Output]:
        faults = self._faults.on(now_ns)
        if CameraFaultKind.UNPLUGGED in faults:
            self._counts["withheld"] += 1
            return []
        if CameraFaultKind.STUCK in faults and self._last is not None:
            frame = replace(frame, colour=self._last.colour, depth=self._last.depth)
        if CameraFaultKind.NO_DEPTH in faults:
            frame = replace(frame, depth=np.zeros_like(frame.depth))
        if CameraFaultKind.SWAPPED in faults:
            frame = replace(frame, colour=np.ascontiguousarray(frame.colour[..., ::-1]))
        self._last = frame
        self._counts["pictures"] += 1
        return [Publish(CAMERA_FRAME, frame, t_ns=frame.colour_time_ns)]

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving."""
        return []

    def report(self) -> Report:
        """Pictures since the start, and how long one takes to draw."""
        counts = {name: float(self._counts[name]) for name in ("pictures", "withheld")}
        state = self._error or ("taking pictures" if self._number else "waiting for the hand")
        return Report(state, counts | {"draw_ms": self._draw_ms})

"""A camera of this machine, or a recording, as a device: a thread that reads it and delivers its pictures."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from common.camera_messages import CameraFrame
from common.clock import Clock, WallClock
from common.messages import Message
from common.service import Report
from common.topics import CAMERA_FRAME, Topic
from services.perception.frames import Frame, FrameSource, Refusal

log = logging.getLogger(__name__)

READ_S = 0.2
REOPEN_S = 1.0  # pause before a camera that is not there is looked for again
SILENT_READS = 15  # in a row, three seconds: it has been unplugged, and must be opened anew
AGAIN_NS = 33_333_333  # from the last picture of a recording to the first, when it is shown again
_LOGGED = ("unopened", "failed", "ended")  # the others may come with every picture
Open = Callable[[], FrameSource]


class CameraPort:
    """Reads frames until it is closed; a camera that fails, or is unplugged, is opened again.

    With `replayed`, capture times are moved to now, and kept as far apart as they were recorded; a recording
    that is over is not opened again.
    """

    name = "camera"

    def __init__(self, open_source: Open, replayed: bool = False, clock: Clock | None = None) -> None:
        self._open_source, self._replayed = open_source, replayed
        self._clock = clock or WallClock()
        self._deliver: Callable[[Topic, Message], None] = lambda _topic, _message: None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera reader", daemon=True)
        self._before_ns: int | None = None  # recorded time of the frame before
        self._shift_ns = self._shown_ns = 0
        self._over = False
        self.counts: Counter[str] = Counter()
        self.last_error = ""
        self._trouble = ""  # the same, until a picture comes

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Begin to read."""
        self._deliver = deliver
        self._thread.start()

    def write(self, message: Message) -> None:
        """A camera takes no commands."""
        raise TypeError(f"the camera takes no {type(message).__name__}")

    def close(self) -> None:
        """Let the camera go."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def report(self) -> Report:
        """Why there is no picture at the moment (empty: there is), and what was read and refused so far."""
        return Report(self._trouble, {f"camera_{name}": float(n) for name, n in dict(self.counts).items()})

    def _run(self) -> None:
        """Whatever a driver raises, the reader goes on: had it ended, the camera would seem unplugged."""
        while not (self._stop.is_set() or self._over):
            try:
                source = self._open_source()
            except Exception as error:
                self._note("unopened", _words(error))
            else:
                self._use(source)
            self._stop.wait(0 if self._over else REOPEN_S)

    def _use(self, source: FrameSource) -> None:
        for part in (lambda: self._read(source), source.close):
            try:
                part()
            except Exception as error:
                self._note("failed", _words(error))

    def _read(self, source: FrameSource) -> None:
        """Deliver what comes, until the source has nothing more to give, or gives nothing any more."""
        silent = 0
        while not self._stop.is_set() and silent < SILENT_READS:
            read = source.read(READ_S)
            if isinstance(read, Frame):
                silent = 0
                self._pass_on(read)
                continue
            silent += read.reason is Refusal.TIMEOUT
            self._note(read.reason.value, read.message)
            if read.reason is Refusal.ENDED:
                self._over = self._replayed
                return

    def _pass_on(self, frame: Frame) -> None:
        shown = self._due(frame) if self._replayed else frame
        if shown is not None:
            self.counts["frames"] += 1
            self._trouble = ""
            self._deliver(CAMERA_FRAME, message_of(shown))

    def _due(self, frame: Frame) -> Frame | None:
        """A recorded frame when its time has come, with that time."""
        now_ns = self._clock.now_ns()
        if self._before_ns is None or frame.t_ns <= self._before_ns:  # it begins, or begins again
            self._shift_ns = max(now_ns, self._shown_ns + AGAIN_NS) - frame.t_ns
        self._before_ns = frame.t_ns
        self._shown_ns = due_ns = frame.t_ns + self._shift_ns
        if self._stop.wait(max(0, due_ns - now_ns) / 1e9):
            return None
        colour_ns, depth_ns = frame.colour_time_ns + self._shift_ns, frame.depth_time_ns + self._shift_ns
        return replace(frame, colour_time_ns=colour_ns, depth_time_ns=depth_ns)

    def _note(self, name: str, message: str) -> None:
        self.counts[name] += 1
        if name in _LOGGED and message != self.last_error:
            log.warning("camera: %s", message)
        self.last_error = self._trouble = message


def _words(error: Exception) -> str:
    """One line; what is not meant for people comes with its type."""
    told = isinstance(error, ValueError | OSError | RuntimeError)
    return str(error) if told else f"{type(error).__name__}: {error}"


def message_of(frame: Frame) -> CameraFrame:
    """A frame as it travels."""
    return CameraFrame(
        colour=frame.colour,
        depth=frame.depth,
        depth_unit_m=frame.depth_unit_m,
        camera_matrix=frame.camera_matrix,
        colour_time_ns=frame.colour_time_ns,
        depth_time_ns=frame.depth_time_ns,
        frame_number=frame.frame_number,
    )

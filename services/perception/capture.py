"""Keeps good views of the calibration plate: sharp, with small errors, from all over the picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common import geometry
from services.perception import rigid
from services.perception.frames import Float64, Frame, FrameSource, Refusal, Refused
from services.perception.plate import Plate, View
from services.perception.recording import Recorder
from services.perception.rig import RigConfig

POSES = "poses.txt"  # beside the pictures: where the palm was, a line a view
COLUMNS, ROWS = 4, 3  # of the picture, for its coverage
TIMEOUT_S = 2.0
PATIENCE = 300  # frames without a usable view before giving up


class CaptureError(Exception):
    """Views could not be captured; the text says why, and what to do."""


class Capture:
    """From a source to a folder that `solve` reads; `say` takes a line for people now and then."""

    def __init__(self, rig: RigConfig, source: FrameSource, folder: Path, say: Callable[[str], None]) -> None:
        self._rig, self._source, self._folder, self._say = rig, source, folder, say
        self._plate = Plate(rig.plate)
        self._covered = np.zeros((ROWS, COLUMNS), np.bool_)
        self._reason = ""

    def run(self, poses: list[Float64] | None, ask: Callable[[str], None]) -> int:
        """Keep the rig's number of views, or one for each pose (4, 4), before which `ask` waits; how many.

        Raises CaptureError, ValueError or OSError.
        """
        recorder = Recorder(self._folder)
        wanted = self._rig.views if poses is None else len(poses)
        try:
            for number in range(wanted):
                if poses is not None:
                    ask(f"move the palm to pose {number + 1} of {wanted}: {line_of(poses[number])}")
                frame, view = self._next()
                recorder.write(frame)
                self._cover(frame, view)
                self._say(f"view {number + 1}/{wanted}: {view.rms_px:.2f} px, {self._coverage()}")
        finally:
            recorder.close()
        if poses is not None:
            (self._folder / POSES).write_text("".join(line_of(pose) + "\n" for pose in poses))
        return wanted

    def _next(self) -> tuple[Frame, View]:
        for frame in self._frames():
            found = self._plate.look(frame.colour, frame.camera_matrix)
            if isinstance(found, View):
                return frame, found
            self._tell(found)
        raise CaptureError(f"no usable view in {PATIENCE} frames: {self._reason}")

    def _frames(self) -> Iterator[Frame]:
        for _ in range(PATIENCE):
            read = self._source.read(TIMEOUT_S)
            if isinstance(read, Frame):
                yield read
            elif read.reason in (Refusal.ENDED, Refusal.TIMEOUT):
                raise CaptureError(f"the camera gives no more pictures: {read.message}; {self._reason}")
            else:
                self._tell(read)

    def _tell(self, reason: str | Refused) -> None:
        text = reason if isinstance(reason, str) else reason.message
        if text != self._reason:
            self._say(f"waiting: {text}")
        self._reason = text

    def _cover(self, frame: Frame, view: View) -> None:
        height, width = frame.depth.shape
        rows = np.clip(view.pixels[:, 1] * ROWS // height, 0, ROWS - 1).astype(int)
        columns = np.clip(view.pixels[:, 0] * COLUMNS // width, 0, COLUMNS - 1).astype(int)
        self._covered[rows, columns] = True

    def _coverage(self) -> str:
        return f"{self._covered.mean():.0%} of the picture covered"


def read_poses(path: Path) -> list[Float64]:
    """Poses (4, 4) from lines `x y z w x y z` (m, quaternion). Raises ValueError naming a bad line."""
    poses: list[Float64] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        poses.append(_pose(line, f"{path}:{number}"))
    return poses


def _pose(line: str, where: str) -> Float64:
    try:
        values: NDArray[np.float64] = np.array([float(word) for word in line.replace(",", " ").split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (7,) or not np.isfinite(values).all() or abs(np.linalg.norm(values[3:]) - 1) > 1e-2:
        raise ValueError(f"{where}: a pose is x y z in metres and a unit quaternion w x y z")
    return rigid.join(values[:3], geometry.normalise(values[3:]))


def line_of(pose: Float64) -> str:
    """A pose (4, 4) as such a line."""
    position, rotation = rigid.split(pose)
    return " ".join(f"{value:.6f}" for value in (*position, *rotation))

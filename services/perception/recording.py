"""Recorded frames on disk: a folder that stays readable wherever the recording was cut off.

`camera.json`: format, K, depth unit, size. `frames.jsonl`: a line a frame (number, both capture times),
written after its pictures `colour_<n>.png` and `depth_<n>.png`, n the line's number from 0; lossless.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2 as compiled_cv2
import numpy as np
from numpy.typing import NDArray

from services.perception.frames import Frame, Refusal, Refused, check_order

cv2: Any = compiled_cv2  # its stubs do not know which type an array keeps
FORMAT = "gc_pmpc camera recording 1"
_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)  # 10 ms a frame and 0.7 MB; more effort saves a tenth of it


class Recorder:
    """Appends frames of one camera to a new folder."""

    def __init__(self, folder: Path) -> None:
        """Raises FileExistsError if there is a recording already."""
        self._folder = folder
        self._first: Frame | None = None
        self._written = 0
        folder.mkdir(parents=True, exist_ok=True)
        self._index = (folder / "frames.jsonl").open("x", encoding="ascii")

    def write(self, frame: Frame) -> None:
        """Append a frame. Raises ValueError if its size, K or depth unit are not those of the first."""
        if self._first is None:
            self._first = frame
            header = json.dumps(_header(frame), indent=1) + "\n"
            (self._folder / "camera.json").write_text(header, encoding="ascii")
        elif _header(frame) != _header(self._first):
            raise ValueError(f"frame {frame.frame_number}: the camera changed; begin another recording")
        colour = cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR)
        for kind, picture in (("colour", colour), ("depth", frame.depth)):
            path = _picture(self._folder, kind, self._written)
            if not cv2.imwrite(str(path), picture, _FAST):
                raise OSError(f"{path}: could not be written")
        line = (frame.frame_number, frame.colour_time_ns, frame.depth_time_ns)
        self._index.write(json.dumps(line) + "\n")
        self._index.flush()
        self._written += 1

    def close(self) -> None:
        """End the recording; may be called twice."""
        self._index.close()


class Player:
    """A recording as a source, as fast as it is read; capture times are the recorded ones."""

    def __init__(self, folder: Path, repeat: bool = False) -> None:
        """Raises ValueError, naming the file, if the folder holds no such recording."""
        self._folder, self._repeat = folder, repeat
        self._camera, self._lines = _read_header(folder), _read_index(folder)
        self._next = 0
        self._before: Frame | None = None

    def __len__(self) -> int:
        return len(self._lines)

    def read(self, timeout_s: float = 0.0) -> Frame | Refused:
        """The next frame; a damaged one is refused and skipped."""
        if self._next >= len(self._lines):
            if not self._repeat or not self._lines:
                return Refused(Refusal.ENDED, f"{self._folder}: no more frames")
            self._next, self._before = 0, None
        line, self._next = self._next, self._next + 1
        try:
            frame = self.load(line)
        except ValueError as error:
            return Refused(Refusal.INVALID, str(error))
        refused = check_order(frame, self._before)
        if refused is None:
            self._before = frame
        return refused or frame

    def load(self, line: int) -> Frame:
        """The frame of that line, from 0. Raises ValueError if its pictures cannot be read."""
        number, colour_time_ns, depth_time_ns = self._lines[line]
        colour = _load(_picture(self._folder, "colour", line), cv2.IMREAD_COLOR)
        depth = _load(_picture(self._folder, "depth", line), cv2.IMREAD_UNCHANGED)
        return Frame(
            cv2.cvtColor(colour, cv2.COLOR_BGR2RGB),
            depth,
            self._camera["depth_unit_m"],
            np.array(self._camera["camera_matrix"], np.float64),
            colour_time_ns,
            depth_time_ns,
            number,
        )

    def close(self) -> None:
        """Nothing is held open."""


def _header(frame: Frame) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "depth_unit_m": frame.depth_unit_m,
        "camera_matrix": frame.camera_matrix.tolist(),
        "height_width": list(frame.depth.shape),
    }


def _picture(folder: Path, kind: str, line: int) -> Path:
    return folder / f"{kind}_{line:06}.png"


def _load(path: Path, flag: int) -> NDArray[Any]:
    picture = cv2.imread(str(path), flag)
    if picture is None:
        raise ValueError(f"{path}: missing or damaged picture")
    return picture


def _read_header(folder: Path) -> dict[str, Any]:
    path = folder / "camera.json"
    try:
        header = json.loads(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: no camera recording ({error})") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError(f"{path}: not a '{FORMAT}'")
    missing = [name for name in ("depth_unit_m", "camera_matrix") if name not in header]
    if missing:
        raise ValueError(f"{path}: {missing[0]} is missing")
    return header


def _read_index(folder: Path) -> list[tuple[int, int, int]]:
    """Whole lines only: what was cut off while writing is left out."""
    lines = (folder / "frames.jsonl").read_text(encoding="ascii").split("\n")[:-1]
    try:
        return [(int(n), int(colour), int(depth)) for n, colour, depth in map(json.loads, lines)]
    except (TypeError, ValueError) as error:
        raise ValueError(f"{folder / 'frames.jsonl'}: damaged index ({error})") from error

"""FoundationPose as a backend: in its own process and environment, its poses judged as everybody's.

It returns no score while it tracks, and its errors feed back: what counts is what the gate says of each pose.
Licence: NVIDIA Source Code License, research and evaluation only; found by configured path, never shipped.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.camera_messages import PoseState
from common.die import Die
from services.perception import foundationpose_worker
from services.perception.backend import PoseEstimate, Unseen
from services.perception.config import FoundationPoseConfig
from services.perception.foreign import ForeignProcess
from services.perception.foundationpose_worker import Arrays
from services.perception.frames import Float64, Frame
from services.perception.mesh_file import textured_mesh

# It answers a mask without depth with the identity and a guessed centre, and says nothing of it.
MIN_MASK_PIXELS = 100
LOST_AFTER = 3  # bad frames in a row

Judge = Callable[[Frame, Float64], PoseEstimate]


class FoundationPoseBackend:
    """Registers once, then tracks; a new process has forgotten everything, and is searched with anew.

    The process ends with this one: its pipe does then, and the supervisor stops the whole process group.

    `judge` makes an estimate of a frame and a pose (4, 4): quality, labels, covariance, and its state.
    """

    def __init__(self, config: FoundationPoseConfig, die: Die, judge: Judge, folder: Path) -> None:
        """Write the textured mesh into `folder`. The process is begun by the first search."""
        self._config, self._judge = config, judge
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._mesh = folder, folder / "die.obj"
        textured_mesh(die).export(self._mesh)
        script = str(Path(foundationpose_worker.__file__).resolve())
        command = [str(config.python), script, str(config.repository)]
        self._process = ForeignProcess(command, folder, folder / "foundationpose.log")
        self._state = PoseState.SEARCHING
        self._bad = 0

    def register(self, frame: Frame, mask: NDArray[np.bool_] | None = None) -> PoseEstimate | Unseen:
        """Find the die where the mask allows it; takes seconds. Raises ForeignError."""
        usable = (frame.depth > 0) & (True if mask is None else mask)
        if np.count_nonzero(usable) < MIN_MASK_PIXELS:
            return self._unseen(frame, "no depth where the die may be")
        if not self._process.running:
            header = {"do": "open", "mesh": str(self._mesh), "debug_dir": str(self._folder / "debug")}
            self._process.ask(header, None, self._config.open_s)
        arrays = _arrays(frame) | {"mask": usable.astype(np.uint8)}
        found = self._judge(frame, self._ask("register", arrays, self._config.register_s))
        if found.state is not PoseState.TRACKING:
            return self._unseen(frame, "FoundationPose's first pose does not fit what is seen")
        return found

    def adopt(self, found: PoseEstimate) -> None:
        """Track from a pose of `register`. Raises ForeignError."""
        self._process.ask({"do": "seed"}, {"pose": found.T_camera_die}, self._config.track_s)
        self._state, self._bad = PoseState.TRACKING, 0

    def track(self, frame: Frame) -> PoseEstimate | Unseen:
        """The pose in this frame from the one before. Raises ForeignError."""
        if self._state is not PoseState.TRACKING:
            return self._unseen(frame, "searching for the die")
        if not self._process.running:
            self._state = PoseState.LOST
            return self._unseen(frame, "FoundationPose has ended: searching anew")
        estimate = self._judge(frame, self._ask("track", _arrays(frame), self._config.track_s))
        self._bad = 0 if estimate.state is PoseState.TRACKING else self._bad + 1
        if self._bad < LOST_AFTER:
            return estimate
        self._state = PoseState.LOST
        return self._unseen(frame, "FoundationPose has drifted off the die: searching anew")

    def reset(self) -> None:
        """Forget the die; the process keeps its weights."""
        self._state, self._bad = PoseState.SEARCHING, 0

    def _ask(self, what: str, arrays: Arrays, timeout_s: float) -> Float64:
        reply = self._process.ask({"do": what}, arrays, timeout_s)
        return np.array(reply["pose"], np.float64).reshape(4, 4)

    def _unseen(self, frame: Frame, message: str) -> Unseen:
        lost = self._state in (PoseState.TRACKING, PoseState.LOST)
        state = PoseState.LOST if lost else PoseState.SEARCHING
        return Unseen(state, message, frame.t_ns, frame.frame_number)


def _arrays(frame: Frame) -> Arrays:
    """A frame as FoundationPose takes it: RGB, metres, K in float64."""
    return {"rgb": frame.colour, "depth": frame.depth_m(), "K": frame.camera_matrix}

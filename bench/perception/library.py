"""Sequences on disk: which ones there are, how they are made and read again.

Each is a folder with a recording (services.perception.recording), `spec.json` and, written last, `truth.npz`:
`T_camera_die` (N, 4, 4) and `occlusion` (N,).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.perception.board import Board
from bench.perception.looks import LIGHTINGS
from bench.perception.sequence import Spec, film
from common.dice import APPEARANCES
from services.perception.frames import Frame
from services.perception.recording import Player, Recorder

Float64 = NDArray[np.float64]

TUNING_SEEDS = (0, 1)
HELD_OUT_SEEDS = (10, 11, 12)
LOOKS_SEEDS = (20,)

# Every one is made for each seed.
_SUITE = (
    Spec("open", 0, 150, grip="open", speed_deg_s=130.0),
    Spec("held_slow", 0, 250, speed_deg_s=70.0),
    Spec("held_fast", 0, 250, speed_deg_s=175.0),
    Spec("covered", 0, 120, grip="covered", speed_deg_s=70.0),
    Spec("far", 0, 120, rate_hz=30.0, distance_m=0.6),
    Spec("far_fast", 0, 60, rate_hz=30.0, distance_m=0.6, speed_deg_s=175.0),
)


def suite(name: str, seeds: Iterable[int] | None = None) -> list[Spec]:
    """The specs of `tuning`, `held_out` or `looks` (appearances by lightings). Raises KeyError otherwise."""
    if name == "looks":
        return [
            Spec(f"look_{look}_{light}-{seed}", seed, 50, appearance=look, lighting=light)
            for seed in seeds or LOOKS_SEEDS
            for look in APPEARANCES
            for light in LIGHTINGS
        ]
    held_out, usual = {"tuning": (False, TUNING_SEEDS), "held_out": (True, HELD_OUT_SEEDS)}[name]
    return [
        replace(spec, name=f"{spec.name}-{seed}", seed=seed, held_out=held_out)
        for seed in seeds or usual
        for spec in _SUITE
    ]


@dataclass(frozen=True)
class Sequence:
    """A sequence read from disk; truth has a row (N, ...) for each frame."""

    spec: Spec
    T_camera_die: Float64
    occlusion: Float64
    player: Player
    board: Board | None = None  # what is held before the camera at times

    def frames(self) -> Iterator[Frame]:
        """All frames in order. Raises ValueError where a picture is damaged."""
        for line in range(len(self.player)):
            frame = self.player.load(line)
            yield frame if self.board is None else self.board.before(frame, line)


def make(spec: Spec, root: Path) -> Path:
    """Film a sequence unless its folder holds it already; the folder."""
    folder = root / spec.name
    if _is_made(spec, folder):
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    recorder = Recorder(folder)
    truths = []
    for frame, truth in film(spec):
        recorder.write(frame)
        truths.append(truth)
    recorder.close()
    (folder / "spec.json").write_text(json.dumps(asdict(spec), indent=1) + "\n", encoding="ascii")
    poses, occlusion = zip(*truths, strict=True)
    np.savez(folder / "truth.npz", T_camera_die=np.array(poses), occlusion=np.array(occlusion))
    return folder


def load(folder: Path) -> Sequence:
    """Read a sequence. Raises ValueError or OSError, naming the file, if it is not whole."""
    spec = Spec(**json.loads((folder / "spec.json").read_text(encoding="ascii")))
    with np.load(folder / "truth.npz") as truth:
        return Sequence(spec, truth["T_camera_die"], truth["occlusion"], Player(folder))


def with_trials(sequence: Sequence, phase: int) -> Sequence:
    """The same sequence with a board before the camera every so often; see `Board`."""
    board = Board(sequence.spec.distance_m, phase)
    camera_matrix = sequence.player.load(0).camera_matrix
    hidden = board.covers(sequence.T_camera_die[:, :3, 3], camera_matrix)
    return replace(sequence, board=board, occlusion=np.maximum(sequence.occlusion, hidden))


def _is_made(spec: Spec, folder: Path) -> bool:
    try:
        return load(folder).spec == spec
    except (OSError, ValueError, TypeError):
        return False

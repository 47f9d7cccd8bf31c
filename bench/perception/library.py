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

from bench.perception.looks import LIGHTINGS
from bench.perception.sequence import Spec, film
from common.dice import APPEARANCES
from services.perception.frames import Frame
from services.perception.recording import Player, Recorder

Float64 = NDArray[np.float64]

TUNING_SEEDS = (0, 1)
HELD_OUT_SEEDS = (10, 11, 12)
LOOKS_SEEDS = (20,)
HIDDEN = "hidden"  # how the names of sequences with trials of re-acquisition begin

# Every one is made for each seed. A trial: 30 frames free, then 20 hidden; 6 a sequence, 18 a seed.
_SUITE = (
    Spec("open", 0, 200, grip="open", speed_deg_s=130.0),
    Spec("held_slow", 0, 300, speed_deg_s=70.0),
    Spec("held_fast", 0, 240, speed_deg_s=175.0),
    Spec("covered", 0, 150, grip="covered", speed_deg_s=70.0),
    Spec("far", 0, 150, rate_hz=30.0, distance_m=0.6),
    Spec("far_fast", 0, 80, rate_hz=30.0, distance_m=0.6, speed_deg_s=175.0),
)
_HIDDEN_SUITE = tuple(
    Spec(f"{HIDDEN}_{part}", 100 * part, 331, grip=grip, hidden_every=50, hidden_frames=20)
    for part, grip in enumerate(("open", "held", "held"))
)


def suite(name: str, seeds: Iterable[int] | None = None) -> list[Spec]:
    """The specs of `tuning`, `held_out` or `looks` (appearances by lightings). Raises KeyError otherwise."""
    if name == "looks":
        return [
            Spec(f"look_{look}_{light}-{seed}", seed, 60, appearance=look, lighting=light)
            for seed in seeds or LOOKS_SEEDS
            for look in APPEARANCES
            for light in LIGHTINGS
        ]
    specs, usual = {
        "tuning": (_SUITE + _HIDDEN_SUITE[1:2], TUNING_SEEDS),
        "held_out": (_SUITE + _HIDDEN_SUITE, HELD_OUT_SEEDS),
    }[name]
    return [
        replace(spec, name=f"{spec.name}-{seed}", seed=spec.seed + seed, held_out=name == "held_out")
        for seed in seeds or usual
        for spec in specs
    ]


@dataclass(frozen=True)
class Sequence:
    """A sequence read from disk; truth has a row (N, ...) for each frame."""

    spec: Spec
    T_camera_die: Float64
    occlusion: Float64
    player: Player

    def frames(self) -> Iterator[Frame]:
        """All frames in order. Raises ValueError where a picture is damaged."""
        return (self.player.load(line) for line in range(len(self.player)))


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


def _is_made(spec: Spec, folder: Path) -> bool:
    try:
        return load(folder).spec == spec
    except (OSError, ValueError, TypeError):
        return False

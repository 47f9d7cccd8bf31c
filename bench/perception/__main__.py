"""`python -m bench.perception --sequences DIR --json`: how well the die is found and followed.

Sequences that are missing in DIR are filmed first (minutes). All figures count frames from the first time
that the die was found in a sequence. A plain ICP is run over the same frames, started from the truth.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2

from bench.perception import summary
from bench.perception.baseline import PlainIcp
from bench.perception.judge import Judged, follow, judge
from bench.perception.library import HELD_OUT_SEEDS, Sequence, load, make, suite, with_trials
from bench.provenance import provenance
from common.dice import APPEARANCES
from common.die import Die
from services.perception.backend import PoseBackend
from services.sim.camera import Optics
from services.sim.depth_noise import DepthNoise

Make = Callable[[Die], PoseBackend]

PHASES = (30, 45, 60)  # when the board comes for the first time, thrice through each sequence
FAR_M = 0.5
DEFAULT_BACKEND = "services.perception.cpu.backend:CpuBackend"


def main(arguments: list[str] | None = None) -> int:
    """Run the backend and the baseline, and print what came out."""
    chosen = _arguments(arguments)
    cv2.setNumThreads(1)
    make_backend = _backend(chosen.backend)
    specs = suite(chosen.suite, chosen.seed)
    sequences = [load(make(spec, chosen.sequences)) for spec in specs]
    report = {
        "backend": chosen.backend,
        **(_looks(sequences, make_backend) if chosen.suite == "looks" else _bands(sequences, make_backend)),
        "seeds": sorted({spec.seed for spec in specs}),
        "conditions": _conditions(sequences),
        "provenance": provenance(),
    }
    text = json.dumps(_rounded(report), indent=None if chosen.json else 1)
    print(text)
    return 0


def _bands(sequences: list[Sequence], make_backend: Make) -> dict[str, Any]:
    """Figures by occlusion, speed and distance, of re-acquisition, and of the baseline."""
    near = [s for s in sequences if s.spec.distance_m < FAR_M]
    far = [s for s in sequences if s.spec.distance_m >= FAR_M]
    trials = [with_trials(s, phase) for s in near if s.spec.grip != "covered" for phase in PHASES]
    judged, judged_far, judged_trials = (_run(part, make_backend) for part in (near, far, trials))
    baseline = _baseline(near)
    times = summary.times(judged)
    return {
        "bands": summary.bands(judged),
        "bands_far": summary.bands(judged_far),
        "errors_by_occlusion": summary.errors_by_occlusion(judged),
        "gross_claimed": summary.gross_claimed(judged)["share"],
        "gross_claimed_far": summary.gross_claimed(judged_far)["share"],
        "gross_claimed_counts": {
            "near": summary.gross_claimed(judged),
            "far": summary.gross_claimed(judged_far),
            "trials": summary.gross_claimed(judged_trials),
        },
        "reacquired": (reacquired := summary.reacquired(judged_trials))["share"],
        "reacquisition": reacquired,
        **times,
        "baseline": baseline,
        "frame_ms_to_baseline": _ratio(times, baseline),
        "sequences": {one.sequence.spec.name: summary.one_line(one) for one in judged + judged_far},
    }


def _looks(sequences: list[Sequence], make_backend: Make) -> dict[str, Any]:
    """Figures for each appearance and lighting."""
    rows: list[dict[str, Any]] = []
    for sequence in sequences:
        spec, judged = sequence.spec, _run([sequence], make_backend)
        row = {"appearance": spec.appearance, "lighting": spec.lighting, **summary.one_line(judged[0])}
        rows.append(row | summary.figures(judged))
    return {"looks": rows}


def _run(sequences: list[Sequence], make_backend: Make) -> list[Judged]:
    """A fresh backend for each sequence; it knows the die, but not where it is."""
    judged: list[Judged] = []
    for sequence in sequences:
        backend = make_backend(APPEARANCES[sequence.spec.appearance].die)
        judged.append(judge(sequence, follow(backend, sequence.frames(), sequence.spec.rate_hz)))
        print(f"{sequence.spec.name}: {summary.one_line(judged[-1])}", file=sys.stderr, flush=True)
    return judged


def _baseline(sequences: list[Sequence]) -> dict[str, Any]:
    """The same figures of a plain ICP, if small_gicp is installed."""
    try:
        judged = [_icp(sequence) for sequence in sequences]
    except ImportError:
        return {"name": "plain ICP", "skipped": "small_gicp is not installed: pip install small_gicp"}
    return {
        "name": "small_gicp PLANE_ICP",
        "bands": summary.bands(judged),
        "errors_by_occlusion": summary.errors_by_occlusion(judged),
        **summary.times(judged),
    }


def _icp(sequence: Sequence) -> Judged:
    backend = PlainIcp(APPEARANCES[sequence.spec.appearance].die, sequence.T_camera_die[0])
    answers = follow(backend, sequence.frames(), sequence.spec.rate_hz)
    answers.started = [True] * len(answers.started)
    return judge(sequence, answers)


def _ratio(times: dict[str, Any], baseline: dict[str, Any]) -> dict[str, float | None]:
    names = ("frame_cpu_ms_median", "frame_cpu_ms_p95")
    known = "skipped" not in baseline
    return {name: times[name] / baseline[name] if known and times[name] else None for name in names}


def _conditions(sequences: list[Sequence]) -> dict[str, Any]:
    return {
        "optics": asdict(Optics()),
        "depth_noise": asdict(DepthNoise()),
        "threads": 1,
        "registration": "in a worker: its result is used as many frames later as its processor time lasts",
        "sequences": [asdict(sequence.spec) for sequence in sequences],
    }


def _backend(name: str) -> Make:
    """`MODULE:CLASS` of a backend that is made from a die alone. Raises SystemExit if there is none."""
    module, _, attribute = name.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise SystemExit(f"--backend {name}: {error}; give MODULE:CLASS") from error


def _rounded(value: Any) -> Any:
    """Five digits are plenty; NaN would be no JSON."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    return [_rounded(part) for part in value] if isinstance(value, list | tuple) else value


def _arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench.perception", description=__doc__)
    parser.add_argument("--sequences", type=Path, required=True, help="folder of sequences, outside git")
    parser.add_argument("--suite", choices=("held_out", "tuning", "looks"), default="held_out")
    parser.add_argument("--seed", type=int, action="append", help=f"instead of {HELD_OUT_SEEDS}; repeatable")
    parser.add_argument("--backend", default=DEFAULT_BACKEND, help="MODULE:CLASS")
    parser.add_argument("--json", action="store_true", help="on one line")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())

"""`python -m bench.perception.live RUN_DIR [--json]`: the poses in the bus logs of a run with a camera.

How old a pose was when a control step used it, and how far the claimed ones were from the twin's truth.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.perception.summary import quantile
from bench.provenance import provenance
from common.built import codec_for
from common.buslog import log_files, read_log
from common.codec import Refused
from common.config import ConfigError
from common.geometry import angle
from common.messages import Sample
from common.task import get_task
from common.topics import OBJECT_POSE, STEP, TWIN_TRUTH
from deploy.record import read_shared

GROSS_M, GROSS_DEG = 0.010, 10.0
_KEYS = {topic.key for topic in (STEP, OBJECT_POSE, TWIN_TRUTH)}
_NS_PER_MS = 1e6


@dataclass
class Seen:
    """What was said in a run."""

    steps: list[tuple[int, Any]] = field(default_factory=list[tuple[int, Any]])  # when, and the step
    poses: list[tuple[int, Sample]] = field(default_factory=list[tuple[int, Sample]])
    truths: dict[int, Any] = field(default_factory=dict[int, Any])  # by capture time


def read(run_dir: Path) -> tuple[Seen, int]:
    """All that was said, and which part of a state is the die's place. Raises ConfigError without logs."""
    task = read_shared(run_dir).task
    seen, codec = Seen(), codec_for(task)
    for t_ns, key, payload in _said(run_dir / "log"):
        try:
            sample = codec.decode(key, payload)
        except Refused:
            continue
        if key == STEP.key and not sample.message.waiting:
            seen.steps.append((t_ns, sample.message))
        elif key == OBJECT_POSE.key:
            seen.poses.append((t_ns, sample))
        elif key == TWIN_TRUTH.key:
            seen.truths[sample.header.t_ns] = sample.message
    if not seen.steps:
        raise ConfigError([f"{run_dir / 'log'}: no control steps; was log.enabled true?"])
    groups = [group.name for group in get_task(task).groups]
    return seen, groups.index("object_position")


def _said(directory: Path) -> Iterator[tuple[int, str, bytes]]:
    for path in log_files(directory):
        for entry in read_log(path):
            if entry.kind == "out" and entry.key in _KEYS:
                yield entry.t_ns, entry.key, entry.payload


def summarise(seen: Seen, part: int) -> dict[str, Any]:
    """Ages of poses at use and at telling, and errors of the claimed ones."""
    used = [float(step.part_age_ms[part]) for _, step in seen.steps if step.part_valid[part]]
    begun = {step.episode for _, step in seen.steps}
    periods = [
        (later - earlier) / _NS_PER_MS
        for (earlier, a), (later, b) in zip(seen.steps, seen.steps[1:], strict=False)
        if a.episode == b.episode
    ]
    told = [(t_ns - pose.header.t_ns) / _NS_PER_MS for t_ns, pose in seen.poses]
    return {
        "episodes": len(begun),
        "steps": len(seen.steps),
        "steps_without_a_pose": len(seen.steps) - len(used),
        "step_period_ms_median": quantile(np.array(periods), 0.5),
        "capture_to_use_ms": _percentiles(used),
        "capture_to_told_ms": _percentiles(told),
        **_errors(seen),
    }


def _percentiles(values: list[float]) -> dict[str, float | None]:
    return {f"p{100 * q:g}": quantile(np.array(values), q) for q in (0.5, 0.9, 0.99)}


def _errors(seen: Seen) -> dict[str, Any]:
    """Of poses of whose picture the truth is known."""
    known = [
        (pose, seen.truths[pose.header.t_ns]) for _, pose in seen.poses if pose.header.t_ns in seen.truths
    ]
    claimed = np.array([pose.header.valid for pose, _ in known], np.bool_)
    off_m = np.array([np.linalg.norm(pose.message.position - true.position) for pose, true in known])
    off_deg = np.array([np.degrees(angle(pose.message.rotation, true.rotation)) for pose, true in known])
    gross = (off_m > GROSS_M) | (off_deg > GROSS_DEG)
    return {
        "claimed": int(claimed.sum()),
        "unclaimed": int((~claimed).sum()),
        "gross_claimed": int((claimed & gross).sum()),
        "gross_unclaimed": int((~claimed & gross).sum()),
        "claimed_off_mm": _percentiles(list(1e3 * off_m[claimed])),
        "claimed_off_deg": _percentiles(list(off_deg[claimed])),
    }


def main(arguments: list[str] | None = None) -> int:
    """Print the figures; 2 after one line about what is wrong."""
    parser = argparse.ArgumentParser(prog="bench.perception.live", description=__doc__)
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR")
    parser.add_argument("--json", action="store_true", help="on one line")
    chosen = parser.parse_args(arguments)
    try:
        found = summarise(*read(chosen.run_dir))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps({**found, "provenance": provenance()}, indent=None if chosen.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(main())

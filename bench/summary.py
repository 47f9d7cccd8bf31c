"""A run in a few numbers, from its rows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.cost import TIMING_FILE, cost_line, training_cost
from bench.statistics import wilson
from common.messages import WARMUP_MODES
from deploy.curriculum_files import read_rows
from deploy.scores import Row

_ABOUT = ("task", "method", "seed", "config_hash")


def summarise(directory: Path) -> dict[str, Any]:
    """Return what a finished run came to: its last evaluation, lateness, and the time that it took."""
    rows = read_rows(directory)
    planned = [row for row in rows if row["mode"] not in WARMUP_MODES]
    sessions = json_lines(directory / "sessions.jsonl")
    return {
        **{name: rows[-1][name] for name in _ABOUT if name in rows[-1]},
        "warmup_steps": sum(row["steps"] for row in rows if row["mode"] in WARMUP_MODES),
        "training_episodes": sum(row["mode"] == "plan" for row in rows),
        "evaluation": result_of(last_evaluation(rows)),
        "late_share": share(planned, "late"),
        "held_share": share(planned, "held"),
        "wall_s": _wall_s(directory),
        "training_cost": training_cost(directory, rows),
        "sessions": len(sessions),
        "commits": sorted({session["commit"] for session in sessions}),
        "cores": sessions[-1]["cores"],
    }


def last_evaluation(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the newest evaluation."""
    evaluated = [row for row in rows if row["mode"] == "evaluate"]
    newest = max((row["trained_episodes"] for row in evaluated), default=0)
    return [row for row in evaluated if row["trained_episodes"] == newest]


def result_of(rows: Sequence[Row]) -> dict[str, Any]:
    """Return return and errors as mean and deviation, successes with their Wilson 95 % intervals."""
    if not rows:
        return {"goals": 0}
    found: dict[str, Any] = {"goals": len(rows)}
    for name in rows[0]:
        if name == "return" or name.startswith("error_"):
            values = np.array([row[name] for row in rows if name in row])
            found[name] = {
                "mean": _rounded(values.mean()),
                "sd": _rounded(values.std()),
                "max": _rounded(values.max()),
            }
        elif name.startswith("success_"):
            found[name] = _success([bool(row[name]) for row in rows])
    return found


def _success(verdicts: Sequence[bool]) -> dict[str, Any]:
    low, high = wilson(sum(verdicts), len(verdicts))
    return {
        "count": sum(verdicts),
        "rate": sum(verdicts) / len(verdicts),
        "wilson_95": [_rounded(low), _rounded(high)],
    }


def _rounded(value: Any) -> float:
    return round(float(value), 6)


def share(rows: Sequence[Row], name: str) -> float:
    """Return which share of all steps `name` counts."""
    steps = sum(row["steps"] for row in rows)
    return _rounded(sum(row[name] for row in rows) / steps) if steps else 0.0


def _wall_s(directory: Path) -> float:
    """Add up the sessions, each as far as it noted an episode."""
    longest: dict[int, float] = {}
    for row in json_lines(directory / TIMING_FILE):
        longest[row["session"]] = row["wall_s"]
    return round(sum(longest.values()), 1)


def json_lines(path: Path) -> list[dict[str, Any]]:
    """Return what a file of JSON lines holds, without a last line that a crash cut short."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def line(summary: dict[str, Any]) -> str:
    """Return the summary as one line for people."""
    head = "{method} on {task}, seed {seed}, {training_episodes} episodes".format(**summary)
    cost = f"{cost_line(summary['training_cost'])}; with evaluations {summary['wall_s']:.0f} s"
    lateness = f"late {summary['late_share']:.1%}, held {summary['held_share']:.1%}"
    return f"{head}: {result_line(summary['evaluation'])}; {lateness}; {cost}"


def result_line(result: dict[str, Any]) -> str:
    """Return an evaluation's main numbers: errors in mm or rad, success with its interval, return."""
    if not result["goals"]:
        return "no evaluation"
    parts = [_error(name, result[name]["mean"]) for name in result if name.startswith("error_")]
    for name in (name for name in result if name.startswith("success_")):
        low, high = result[name]["wilson_95"]
        rate = f"{result[name]['count']}/{result['goals']} ({low:.0%} to {high:.0%})"
        parts.append(f"{name.removeprefix('success_')} {rate}")
    if "return" in result:
        parts.append(f"return {result['return']['mean']:.3f} ± {result['return']['sd']:.3f}")
    return ", ".join(parts)


def _error(name: str, value: float) -> str:
    label = name.removeprefix("error_")
    if label.endswith("_m"):
        return f"{label.removesuffix('_m').replace('_', ' ')} {value * 1e3:.1f} mm"
    return f"{label.removesuffix('_rad').replace('_', ' ')} {value:.2f} rad"

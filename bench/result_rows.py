"""The rows that results are compared by: one per evaluation of a run, the same columns for every method."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.cost import training_cost
from bench.references import HELD, reference_rows
from bench.statistics import wilson
from bench.summary import json_lines
from common.storage import write_atomically
from deploy.curriculum_files import read_rows
from deploy.scores import Row

SESSIONS_FILE = "sessions.jsonl"  # of bench.run: commit, cores and versions of each start
EVALUATIONS = "evaluations"  # of bench.evaluate: a file for each evaluation of a trained model
LEAST_CEILING = 0.10  # success of the oracle below which a ratio to it says nothing

_CRITERIA = ("success_paper", "success_worst", "success_15d", "success_env")
_ERRORS = {  # column → what rows call it, and the factor to the column's unit
    "mean_finger_error_mm": ("error_mean_finger_m", 1000.0),
    "rot_error_rad": ("error_rotation_rad", 1.0),  # 2·arccos|⟨q, q*⟩|
    "pos_error_mm": ("error_position_m", 1000.0),
}


def result_row(about: Mapping[str, Any], rows: Sequence[Row], reference: Sequence[Row] = ()) -> Row:
    """Put together what one evaluation came to; columns that a task lacks are None.

    `about` is copied (`about_run`); `reference` holds the ceiling's rows of these goals, or of some, and what
    stands beside the ceiling is then of those.
    """
    successes = {name: _rate(name, rows) for name in _CRITERIA}
    errors = {name: _mean(key, rows, factor) for name, (key, factor) in _ERRORS.items()}
    intervals = {
        name: [round(bound, 4) for bound in wilson(sum(row[name] for row in rows), len(rows))]
        for name, rate in successes.items()
        if rate is not None
    }
    returns = _mean("return", rows, 1.0)
    beside = {"goals": len(rows), "return_mean": returns, **successes, **_beside(rows, reference)}
    return {**about, **beside, "ci95": intervals, **errors}


def rows_of_run(directory: Path) -> list[Row]:
    """One row for each evaluation of a run that `bench.run` made, in order."""
    rows = read_rows(directory)
    evaluated = [row for row in rows if row["mode"] == "evaluate"]
    found: list[Row] = []
    for episode in sorted({row["trained_episodes"] for row in evaluated}):
        now = [row for row in evaluated if row["trained_episodes"] == episode]
        about = about_run(directory, rows, now[0])
        found.append(result_row(about, now, references_of(now)))
    return found


def results_of(directory: Path) -> list[Row]:
    """All rows of a run: one for each evaluation and, if `bench.evaluate` had more goals, its final one."""
    rows, final = rows_of_run(directory), final_row(directory)
    of_curve = rows[-1]["goals"] if rows else 0
    return [*rows, final] if final and final["goals"] > of_curve else rows


def is_of_bench(directory: Path) -> bool:
    """Whether `bench.run` made the run, and so tells commit and cores."""
    return (directory / SESSIONS_FILE).exists()


def trained_episodes(rows: Sequence[Row]) -> int:
    """How many training episodes are among a run's rows."""
    return sum(row["mode"] == "plan" for row in rows)


def keep_evaluation(directory: Path, rows: Sequence[Row], commit: str) -> None:
    """Keep how goals went with the model as the run left it, where `final_row` finds it."""
    episode = trained_episodes(read_rows(directory))
    text = "".join(json.dumps({**row, "evaluation_commit": commit}) + "\n" for row in rows)
    (directory / EVALUATIONS).mkdir(exist_ok=True)
    write_atomically(directory / EVALUATIONS / f"{episode:06}_{len(rows):04}.jsonl", text.encode())


def kept_evaluation(directory: Path, episode: int) -> list[Row]:
    """How the goals went in the largest evaluation after `episode` training episodes; empty without one."""
    files = sorted((directory / EVALUATIONS).glob(f"{episode:06}_*.jsonl"))
    return json_lines(files[-1]) if files else []


def final_row(directory: Path) -> Row | None:
    """What a run came to, on more goals than its last evaluation had; None if nobody has looked.

    Commit, configuration, wall time and cores are those of the training.
    """
    trained = read_rows(directory)
    rows = kept_evaluation(directory, trained_episodes(trained))
    if not rows:
        return None
    end = {"trained_episodes": trained_episodes(trained), "episode": trained[-1]["episode"] + 1}
    about = about_run(directory, trained, {**trained[-1], **end})
    return {**result_row(about, rows, references_of(rows)), "evaluation_commit": rows[0]["evaluation_commit"]}


def references_of(rows: Sequence[Row]) -> list[Row]:
    """The committed ceiling of an evaluation's goals."""
    return reference_rows(rows[0]["task"], [row["episode_seed"] for row in rows])


def about_run(directory: Path, rows: Sequence[Row], at: Row) -> Row:
    """Whose result it is, at the evaluation that begins with the row `at` of the run."""
    session = json_lines(directory / SESSIONS_FILE)[-1]
    return {
        "task": at["task"],
        "method": at.get("method"),
        "label": label_of(directory, at),
        "seed": at["seed"],
        "episode": at["trained_episodes"],
        "config_hash": at.get("config_hash"),
        "commit": session["commit"],
        **training_cost(directory, rows, at["episode"]),
        "cores": session["cores"],
    }


def label_of(directory: Path, row: Row) -> str:
    """What a run's curves are called: its group's name in a sweep (OUT/TASK/NAME/SEED), or its method."""
    task, name, seed = ("", "", "", *directory.resolve().parts)[-3:]
    in_sweep = (task, seed) == (row["task"], str(row["seed"]))
    return name if in_sweep else row.get("method", directory.name)


def _beside(rows: Sequence[Row], reference: Sequence[Row]) -> dict[str, Any]:
    """Success over reachable goals, and ratios to the oracle's success or, where it has none, error."""
    names = ("success_reachable", "success_of_ceiling", "error_over_ceiling")
    found: dict[str, Any] = {**dict.fromkeys(names), "ceiling_goals": 0}
    if not reference:
        return found
    shared = {row["episode_seed"] for row in reference}
    rows = [row for row in rows if row["episode_seed"] in shared]
    found["ceiling_goals"] = len(rows)
    if reference[0]["budget"] == HELD:
        reachable = {row["episode_seed"] for row in reference if row["success_paper"]}
        kept = [row for row in rows if row["episode_seed"] in reachable]
        return {**found, "success_reachable": _rate("success_paper", kept)}
    ours, theirs = _rate("success_paper", rows), _rate("success_paper", reference)
    if theirs is not None and theirs >= LEAST_CEILING:
        return {**found, "success_of_ceiling": _ratio(ours, theirs)}
    counted = ("rot_error_rad", "pos_error_mm") if rows[0]["task"] == "egg" else ("rot_error_rad",)
    ratios = [_ratio(*(_mean(_ERRORS[name][0], each, 1.0) for each in (rows, reference))) for name in counted]
    return {**found, "error_over_ceiling": max((r for r in ratios if r is not None), default=None)}


def _rate(name: str, rows: Sequence[Row]) -> float | None:
    verdicts = [bool(row[name]) for row in rows if name in row]
    return round(sum(verdicts) / len(verdicts), 4) if verdicts else None


def _mean(name: str, rows: Sequence[Row], factor: float) -> float | None:
    values = [row[name] for row in rows if name in row]
    return round(factor * sum(values) / len(values), 5) if values else None


def _ratio(ours: float | None, theirs: float | None) -> float | None:
    return round(ours / theirs, 4) if ours is not None and theirs else None

"""Of the page of results: steps to a return on reach, ablations, and what a run costs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.columns import ERRORS, NONE, RETURN, number, percent, seeds_of, span
from bench.figures import STEPS_FILE
from bench.methods import METHODS, configure
from bench.outcomes import Outcome, Outcomes
from bench.stated import (
    ABLATION_TASKS,
    ABLATIONS,
    COMPARED,
    EPISODE_STEPS,
    FURTHER,
    OURS,
    RETURN_BAR,
    TASKS,
    WARMUP_STEPS,
)
from deploy.markdown import code, table

_STEPS = f"""## Steps to a return of {RETURN_BAR} on reach

![Return over steps]({STEPS_FILE})

Steps in the environment, {WARMUP_STEPS} of warm-up included, at the first evaluation whose mean return
was {RETURN_BAR} or more, and in brackets at the evaluation before it: means over the seeds that got there.
Where none did, the ratio is that of the longest run.

"""
_ABLATIONS = f"""## Ablations

Each is `{OURS}` with one difference. Success is by the paper's bar; the error is that of the mean finger,
mm, or of rotation, rad.

"""


def steps(found: Mapping[str, Outcome]) -> str:
    """When each method first passed the bar on reach, all steps counted, as a ratio to ours."""
    ours = _first_steps(found[OURS]) if OURS in found else None
    rows = [_steps_row(found[label], ours) for label in (*COMPARED, *FURTHER) if label in found]
    heads = ("method", "seeds that passed", "steps", "ratio to ours", "longest run, steps")
    return _STEPS + table(heads, rows)


def _steps_row(outcome: Outcome, ours: float | None) -> tuple[str, ...]:
    passes = outcome.first_passes("return_mean", RETURN_BAR)
    passed = sum(each is not None for each in passes)
    steps = _first_steps(outcome)
    longest = WARMUP_STEPS + EPISODE_STEPS * max(row["episode"] for row in outcome.finals)
    ratio = steps / ours if steps and ours else longest / ours if ours else None
    return (
        code(outcome.label),
        f"{passed} of {len(passes)}",
        NONE if steps is None else f"{steps:.0f} ({_earliest(outcome):.0f})",
        NONE if ratio is None else f"{'' if steps else '> '}{ratio:.1f}",
        str(longest),
    )


def _first_steps(outcome: Outcome) -> float | None:
    passes = [each for each in outcome.first_passes("return_mean", RETURN_BAR) if each is not None]
    return WARMUP_STEPS + EPISODE_STEPS * sum(passes) / len(passes) if passes else None


def _earliest(outcome: Outcome) -> float:
    """Mean over seeds of the steps at the evaluation before the bar was passed."""
    before: list[int] = []
    for curve, passed in zip(
        outcome.curves("return_mean"), outcome.first_passes("return_mean", RETURN_BAR), strict=True
    ):
        if passed is not None:
            before.append(
                max((WARMUP_STEPS + EPISODE_STEPS * each for each in curve if each < passed), default=0)
            )
    return sum(before) / len(before)


def ablations(outcomes: Outcomes) -> str:
    heads = [f"{task}: {name}" for task in ABLATION_TASKS for name in ("seeds", "success", "error", "return")]
    rows = [_ablation_row(label, outcomes) for label in (OURS, *ABLATIONS)]
    return _ABLATIONS + table(("method", "what it is", *heads), rows)


def _ablation_row(label: str, outcomes: Outcomes) -> tuple[str, ...]:
    cells: list[str] = []
    for task, seeds in ABLATION_TASKS.items():
        outcome = outcomes.get(task, {}).get(label)
        if label != OURS and _hash(task, label) == _hash(task, OURS):
            cells += ["the cell is so already", NONE, NONE, NONE]
        elif outcome is None:
            cells += ["none", NONE, NONE, NONE]
        else:
            numbers = (number(outcome, column) for column in (ERRORS[task][0], RETURN))
            cells += [seeds_of(outcome, seeds), percent(outcome.success("success_paper")), *numbers]
    return (code(label), METHODS[label].about, *cells)


def _hash(task: str, method: str) -> str:
    return configure(task, method, (), Path()).config_hash


def cost(outcomes: Outcomes) -> str:
    rows = [_cost_row(task, outcomes.get(task, {}).get(OURS)) for task in TASKS]
    return f"## What a run of `{OURS}` costs\n\nOne seed, evaluations left out.\n\n" + table(
        ("task", "episodes", "CPU, min", "plan", "train", "simulate", "other", "wall time, min"), rows
    )


def _cost_row(task: str, outcome: Outcome | None) -> tuple[str, ...]:
    if outcome is None:
        return (task, *[NONE] * 7)
    spent, wall_s = outcome.cpu_s, outcome.mean("wall_s") or 0.0
    total_s = sum(spent.values()) if spent else 0.0
    shares = [f"{each / total_s:.0%}" for each in spent.values()] if spent and total_s else [NONE] * 4
    minutes = f"{total_s / 60:.0f}" if spent else NONE
    return (task, span(row["episode"] for row in outcome.finals), minutes, *shares, f"{wall_s / 60:.0f}")

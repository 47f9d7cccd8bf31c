"""What is possible on the true simulator, goal by goal: the references that learned control is held to.

    python -m bench.ceiling --task egg_rotate --goals 30 --rows bench/results/ceiling_egg_rotate.jsonl --json

Reach: the best held posture of each goal. Manipulation: the oracle, with growing budgets until it no longer
improves. Started again it goes on behind the last goal in the file of `--rows`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import track

from bench.held_posture import score as held_score
from bench.methods import configure
from bench.oracle import Budget, Oracle
from bench.provenance import provenance
from bench.references import HELD, best
from bench.summary import result_line, result_of
from common.config import ConfigError, digest
from deploy.curriculum_config import FIRST_EVALUATION_SEED
from deploy.curve import read_episodes
from deploy.scores import Row, main_error
from services.sim.plant import ENV_IDS, ShadowHandPlant

# Each about three times the simulated steps of the one before.
LADDER = (
    Budget(32, 2, 10, 4),
    Budget(64, 2, 16, 4),
    Budget(128, 3, 16, 4),
    Budget(256, 4, 20, 5),
    Budget(512, 5, 25, 6),
)
_LEAST_GAIN = 0.05  # relative decrease of the mean error that counts as improvement

Score = Callable[[int], Row]


def ceiling(
    budgets: Mapping[str, Score], seeds: Sequence[int], labels: Mapping[str, Any], file: Path | None
) -> list[Row]:
    """Score the goals with one budget after the other until one does not improve; returns all rows.

    Rows are appended to `file` as they come, and those already in it are not computed again.
    """
    rows = read_episodes(file) if file else []
    before: list[Row] = []
    for name, score in budgets.items():
        known = [row for row in rows if row["budget"] == name]
        done = {row["episode_seed"] for row in known}
        for seed in track([s for s in seeds if s not in done], name, console=Console(file=sys.stderr)):
            begun_s = time.monotonic()
            row = {**labels, "budget": name, "episode_seed": seed, **score(seed)}
            row["wall_s"] = round(time.monotonic() - begun_s, 1)
            rows.append(row)
            _append(file, row)
        now = [row for row in rows if row["budget"] == name and row["episode_seed"] in seeds]
        if before and not improved(before, now):
            break
        before = now
    return rows


def improved(before: Sequence[Row], now: Sequence[Row]) -> bool:
    """Whether a budget reaches more goals than the one before, or comes clearly nearer to them."""
    errors = [sum(main_error(row)[1] for row in rows) for rows in (before, now)]
    reached = [sum(row["success_paper"] for row in rows) for rows in (before, now)]
    return reached[1] > reached[0] or errors[1] < (1 - _LEAST_GAIN) * errors[0]


def scores(task: str, overrides: Sequence[str], threads: int) -> tuple[dict[str, Score], str]:
    """What scores a goal, by name of the budget, and the hash of what it depends on. Raises ConfigError."""
    if task == "reach":
        plant = ShadowHandPlant(task)
        return {HELD: lambda seed: held_score(plant, seed)}, HELD
    cell = configure(task, "gc_pmpc_plus", overrides, Path())
    if cell.control.steps_per_plan == "auto":
        raise ConfigError(["control.steps_per_plan: the oracle needs a number"])
    x = cell.control.steps_per_plan

    @cache
    def oracle(budget: Budget) -> Oracle:
        return Oracle(task, budget.applied(cell.planner), x, threads)

    return {b.name: lambda seed, b=b: oracle(b).score(seed) for b in LADDER}, digest(cell.planner)


def main() -> None:
    """Command line."""
    arguments = _arguments()
    torch.set_num_threads(1)
    seeds = range(arguments.seed, arguments.seed + arguments.goals)
    try:
        budgets, config_hash = scores(arguments.task, arguments.overrides, arguments.threads)
    except ConfigError as error:
        sys.exit(f"bench.ceiling: {error}")
    if arguments.budgets:
        budgets = {name: budgets[name] for name in arguments.budgets}
    labels = {"task": arguments.task, "method": "oracle", "config_hash": config_hash}
    rows = ceiling(budgets, seeds, {**labels, "commit": provenance()["commit"]}, arguments.rows)
    by_budget = {name: result_of([r for r in rows if r["budget"] == name]) for name in budgets}
    chosen = best(rows)
    if arguments.json:
        found = {**labels, "best": chosen[0]["budget"], "budgets": by_budget, **provenance()}
        print(json.dumps(found))
    else:
        print("\n".join(f"{name:16} {result_line(result)}" for name, result in by_budget.items()))


def _append(file: Path | None, row: Row) -> None:
    if file:
        with file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(row) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench.ceiling", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--task", choices=list(ENV_IDS), default="reach")
    parser.add_argument("--goals", type=int, default=30)
    parser.add_argument("--seed", type=int, default=FIRST_EVALUATION_SEED, help="of the first goal")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="one JSON line per goal and budget")
    parser.add_argument(
        "--budget", dest="budgets", action="append", default=[], choices=[b.name for b in LADDER]
    )
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    parser.add_argument("--threads", type=int, default=1, help="on which candidates are simulated")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args()


if __name__ == "__main__":
    main()

"""What is possible at all, as `bench.ceiling` found it and the repository holds it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from deploy.curve import read_episodes
from deploy.scores import Row, main_error

RESULTS = Path(__file__).parent / "results"
HELD = "held"  # the only budget of reach: its best held posture
LEAST_SHARED = 30  # goals that a ceiling must have in common with a longer evaluation


def best(rows: Sequence[Row]) -> list[Row]:
    """The rows of the budget that reaches most goals; of two equal ones, of the nearer."""
    budgets = {row["budget"]: [each for each in rows if each["budget"] == row["budget"]] for row in rows}
    widest = max(len(each) for each in budgets.values())

    def rank(found: list[Row]) -> tuple[int, float]:
        return sum(row["success_paper"] for row in found), -sum(main_error(row)[1] for row in found)

    return max((each for each in budgets.values() if len(each) == widest), key=rank)


def reference_rows(task: str, seeds: Sequence[int], directory: Path = RESULTS) -> list[Row]:
    """The committed ceiling of these goals, or of 30 and more among them; empty when it knows fewer."""
    file = directory / f"ceiling_{task}.jsonl"
    wanted = [row for row in read_episodes(file) if row["episode_seed"] in seeds]
    found = best(wanted) if wanted else []
    return found if len(found) >= min(len(set(seeds)), LEAST_SHARED) else []

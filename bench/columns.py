"""The numbers that methods are compared by, and how they are written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from bench.outcomes import Outcome, Success
from bench.stated import SEEDS, TASKS

NONE = "–"


@dataclass(frozen=True)
class Column:
    """One of the numbers that methods are compared by; `sign` is +1 where more is better."""

    key: str
    heading: str
    digits: int
    sign: int


RETURN = Column("return_mean", "return", 2, +1)
ERRORS: Mapping[str, tuple[Column, ...]] = {
    "reach": (Column("mean_finger_error_mm", "mean finger error, mm", 2, -1),),
    **{
        task: (
            Column("rot_error_rad", "rotation error, rad", 2, -1),
            Column("pos_error_mm", "position error, mm", 1, -1),
        )
        for task in TASKS[1:]
    },
}
CRITERIA: Mapping[str, Mapping[str, str]] = {
    "reach": {
        "success_paper": "mean finger < 2 mm",
        "success_worst": "worst finger < 2 mm",
        "success_15d": "15-D < 2 mm",
        "success_env": "15-D < 10 mm",
    },
    "egg": {"success_paper": "< 0.5 rad and < 5 mm", "success_env": "< 0.1 rad and < 10 mm"},
    **{task: {"success_paper": "< 0.5 rad", "success_env": "< 0.1 rad"} for task in TASKS[2:]},
}
BESIDE: Mapping[str, Mapping[str, str]] = {
    "reach": {"success_reachable": "of reachable"},
    **{
        task: {"success_of_ceiling": "of the oracle's", "error_over_ceiling": "error / oracle's"}
        for task in TASKS[1:]
    },
}


def percent(success: Success | None) -> str:
    """A success rate with its interval."""
    if success is None:
        return NONE
    low, high = success.interval
    return f"{success.rate:.0%} ({100 * low:.0f}–{100 * high:.0f})"


def number(outcome: Outcome, column: Column) -> str:
    """Mean and deviation over seeds."""
    value, deviation = outcome.mean(column.key), outcome.deviation(column.key)
    if value is None:
        return NONE
    return f"{value:.{column.digits}f}" + ("" if deviation is None else f" ± {deviation:.{column.digits}f}")


def span(values: Iterator[int]) -> str:
    """The one value that there is, or the least and the greatest."""
    found = sorted(set(values))
    return str(found[0]) if len(found) == 1 else f"{found[0]}–{found[-1]}"


def seeds_of(outcome: Outcome | None, wanted: Sequence[int] = SEEDS) -> str:
    """Which seeds have been run, and which have not."""
    found = outcome.runs if outcome else {}
    missing = [seed for seed in wanted if seed not in found]
    said = [", ".join(map(str, found)) or "none"]
    said += [f"missing {', '.join(map(str, missing))}"] if found and missing else []
    return "; ".join(said)

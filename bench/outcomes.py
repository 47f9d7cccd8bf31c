"""What the committed rows say of each method on each task: its runs, how they ended, and their curves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, stdev

from bench.run_curves import Curve
from bench.statistics import wilson
from deploy.scores import Row


@dataclass(frozen=True)
class Success:
    """Goals of all seeds together: how many were met, of how many, and Wilson's 95 % interval in [0, 1].

    The interval takes goals as independent, though the seeds share them.
    """

    count: int
    goals: int

    @property
    def rate(self) -> float:
        """In [0, 1]."""
        return self.count / self.goals

    @property
    def interval(self) -> tuple[float, float]:
        """Low and high end."""
        return wilson(self.count, self.goals)


@dataclass(frozen=True)
class Outcome:
    """All runs of one label (a method, or a named group of a sweep) on one task, by seed."""

    label: str
    runs: Mapping[int, Sequence[Row]]

    @property
    def finals(self) -> list[Row]:
        """The last row of each seed; of an episode's rows, the one of most goals."""
        return [max(rows, key=lambda row: (row["episode"], row["goals"])) for rows in self.runs.values()]

    def values(self, column: str) -> list[float]:
        """The column at the end of each seed that has it."""
        return [row[column] for row in self.finals if row.get(column) is not None]

    def mean(self, column: str) -> float | None:
        """Mean over seeds; None if the task lacks the column."""
        values = self.values(column)
        return mean(values) if values else None

    def deviation(self, column: str) -> float | None:
        """Sample deviation over seeds; None with fewer than two."""
        values = self.values(column)
        return stdev(values) if len(values) > 1 else None

    def success(self, criterion: str) -> Success | None:
        """All seeds' goals together; None if the task lacks the criterion."""
        rows = [row for row in self.finals if row.get(criterion) is not None]
        if not rows:
            return None
        return Success(
            sum(round(row[criterion] * row["goals"]) for row in rows), sum(row["goals"] for row in rows)
        )

    def curve(self, column: str, seed: int) -> Curve:
        """Training episodes → the column; a final row of more goals is no point of the curve."""
        rows = sorted(self.runs[seed], key=lambda row: (row["episode"], -row["goals"]))
        return {row["episode"]: row[column] for row in rows if row.get(column) is not None}

    def curves(self, column: str) -> list[Curve]:
        """Of every seed."""
        return [self.curve(column, seed) for seed in self.runs]

    def first_passes(self, column: str, bar: float) -> list[int | None]:
        """Of every seed: training episodes before the first evaluation at or above the bar, if any."""
        return [
            next((episode for episode, value in sorted(curve.items()) if value >= bar), None)
            for curve in self.curves(column)
        ]

    @property
    def cpu_s(self) -> dict[str, float] | None:
        """Processor time of training, by kind, mean over the seeds that were metered."""
        metered = [row["cpu_s"] for row in self.finals if row.get("cpu_s")]
        return {kind: mean(each[kind] for each in metered) for kind in metered[0]} if metered else None


Outcomes = Mapping[str, Mapping[str, Outcome]]  # task → label → its runs


def outcomes(rows: Sequence[Row]) -> Outcomes:
    """Sort committed rows by task, label and seed."""
    found: dict[str, dict[str, dict[int, list[Row]]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(list))
    )
    for row in rows:
        found[row["task"]][row["label"]][row["seed"]].append(row)
    return {
        task: {label: Outcome(label, dict(sorted(runs.items()))) for label, runs in labels.items()}
        for task, labels in found.items()
    }

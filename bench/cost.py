"""What a run costs: processor time of planning, training and simulating, measured around the services.

Processor time, of all threads, is what a run would take alone on a core; wall time also counts how busy the
machine was with other things.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

from common.runner import Dispatcher
from common.service import Job
from deploy.curve import read_episodes
from deploy.scores import Row

TIMING_FILE = "timing.jsonl"  # of bench.run: when each episode began, and what the session had cost by then

KINDS = ("plan", "train", "simulate", "other")
_OF_SERVICE = MappingProxyType({"planner": "plan", "learner": "train", "agent": "train", "sim": "simulate"})
_OF_JOB = MappingProxyType({"act": "plan"})  # an agent's service learns and acts


class Meter:
    """Charges this process's time to one kind at a time, as a chess clock does."""

    def __init__(self) -> None:
        self._spent_s: dict[str, float] = dict.fromkeys(KINDS, 0.0)
        self._kind = "other"
        self._since_s = time.process_time()

    def enter(self, kind: str) -> str:
        """Charge to `kind` from now on; returns what it was before."""
        now_s, before = time.process_time(), self._kind
        self._spent_s[before] += now_s - self._since_s
        self._kind, self._since_s = kind, now_s
        return before

    def read(self) -> dict[str, float]:
        """Seconds by kind until now."""
        self.enter(self._kind)
        return {kind: round(spent_s, 3) for kind, spent_s in self._spent_s.items()}


class MeteredDispatcher(Dispatcher):
    """Measures what its service and the service's jobs cost; for lock-step, where a job runs at its start."""

    def __init__(self, meter: Meter, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._meter = meter
        self._kind = _OF_SERVICE.get(self.service.name, "other")

    def step(self, now_ns: int, ticks: int, start_job: Callable[[Job], None]) -> None:
        """As ever, on the service's account."""

        def start(job: Job) -> None:
            before = self._meter.enter(_OF_JOB.get(job.name, self._kind))
            start_job(job)
            self._meter.enter(before)

        before = self._meter.enter(self._kind)
        super().step(now_ns, ticks, start)
        self._meter.enter(before)


def training_cost(directory: Path, rows: Sequence[Row], before: float = float("inf")) -> dict[str, Any]:
    """`wall_s` and, by kind, `cpu_s` of a run's warm-up, episodes and updates ahead of episode `before`.

    Evaluations are not counted. `cpu_s` is None for a run that was not metered from its beginning.
    """
    evaluations = {row["episode"] for row in rows if row["mode"] == "evaluate"}
    spans = [
        (note, later)
        for note, later in pairwise(read_episodes(directory / TIMING_FILE))
        if note["session"] == later["session"] and note["episode"] < before
        if note["episode"] not in evaluations
    ]
    wall_s = sum(end["wall_s"] - start["wall_s"] for start, end in spans)
    metered = bool(spans) and all("cpu_s" in note for span in spans for note in span)
    return {"wall_s": round(wall_s, 1), "cpu_s": _cpu_s(spans) if metered else None}


def _cpu_s(spans: Sequence[tuple[Row, Row]]) -> dict[str, float]:
    return {
        kind: round(sum(end["cpu_s"][kind] - start["cpu_s"][kind] for start, end in spans), 1)
        for kind in KINDS
    }


def cost_line(cost: Mapping[str, Any]) -> str:
    """The cost of training for people: seconds and the shares of each kind."""
    said = f"training took {cost['wall_s']:.0f} s"
    if not cost["cpu_s"]:
        return said
    total_s = sum(cost["cpu_s"].values())
    shares = ", ".join(
        f"{kind} {spent_s / max(total_s, 1e-9):.0%}" for kind, spent_s in cost["cpu_s"].items()
    )
    return f"{said}, {total_s:.0f} s of CPU: {shares}"

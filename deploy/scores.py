"""What an episode was worth: return, final errors and lateness, from the steps that the plant published."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from common.messages import WARMUP_MODES, Chunk, Fallback, Sample, Step
from common.task import Task

Row = dict[str, Any]  # one line of episodes.jsonl

_DIGITS = 7  # of what is written in m, rad and reward: far below what any of them means


@dataclass(frozen=True)
class _Planned:
    """What is known of a chunk by its number."""

    commit: int
    snapshot_id: str


class EpisodeTrace:
    """The steps of one episode; begins anew when a restarted plant runs the episode again."""

    def __init__(self, episode: int, assumed_commit: int | None = None) -> None:
        """`assumed_commit` is x for chunks that never arrived here; None: their steps are not late."""
        self.episode = episode
        self.waiting = False  # the plant stands still until it gets a plan
        self.k = -1
        self.boot_id = 0
        self._seq = -1
        self._steps: dict[int, Step] = {}
        self._chunks: dict[int, _Planned] = {}
        self._assumed_commit = assumed_commit

    def add_chunk(self, sample: Sample) -> None:
        """Remember how many actions of a chunk were meant to be executed."""
        chunk: Chunk = sample.message
        if chunk.episode == self.episode:
            self._chunks[sample.header.seq] = _Planned(chunk.commit, chunk.snapshot_id)

    def add(self, sample: Sample) -> bool:
        """Take one step of this episode; True when it was the last."""
        step: Step = sample.message
        header = sample.header
        if header.boot_id != self.boot_id:
            self.boot_id, self._steps, self._seq = header.boot_id, {}, -1
        if header.seq <= self._seq:
            return False
        self._seq, self.k, self.waiting = header.seq, step.k, step.waiting
        if not step.waiting:
            self._steps[step.k] = step
        return step.last

    def score(self, task: Task) -> Row:
        """Return the result: return over the states k = 1.., errors and successes at the end, and counts.

        Without `return` if a step never arrived. A state with a part that nobody measured, such as a pose
        of the die that perception does not claim, earns nothing: the others' mean reward stands for it, the
        end is judged by the last whole state, and without one at the very end there is no success.
        """
        last = self._steps[self.k]
        executed = [step for k, step in sorted(self._steps.items()) if k > 0]
        seen = [step for step in executed if step.part_valid.all()]
        end = seen[-1] if seen else last
        state, goal = end.state.astype(np.float64), last.goal.astype(np.float64)
        missing = last.k + 1 - len(self._steps)
        whole = bool(last.part_valid.all())
        errors = {f"error_{name}": _rounded(value) for name, value in task.errors(state, goal).items()}
        successes = {name: bool(value) and whole for name, value in task.successes(state, goal).items()}
        earned = _return(task, seen, len(executed))
        return {
            "steps": last.k,
            **({} if missing or earned is None else {"return": earned}),
            **errors,
            **successes,
            **self._counts(executed),
            "dropped": any(step.dropped for step in self._steps.values()),
            "missing_steps": missing,
            "unseen_steps": len(executed) - len(seen),
            "snapshot_id": self._snapshot_id(executed),
        }

    def _counts(self, executed: list[Step]) -> dict[str, int]:
        """Count where the actions came from; held: repeated or relaxed for want of a plan."""
        fallbacks = Counter(step.fallback for step in executed)
        return {
            "planned": sum(step.chunk_seq >= 0 for step in executed),
            "late": sum(self._late(step) for step in executed),
            "held": fallbacks[Fallback.HOLD] + fallbacks[Fallback.RELAX],
            **{f"fallback_{f.value}": fallbacks[f] for f in Fallback if f is not Fallback.NONE},
        }

    def _late(self, step: Step) -> bool:
        if step.chunk_seq < 0:
            return False
        chunk = self._chunks.get(step.chunk_seq)
        commit = chunk.commit if chunk else self._assumed_commit
        return commit is not None and step.chunk_offset >= commit

    def _snapshot_id(self, executed: list[Step]) -> str:
        known = [self._chunks[s.chunk_seq].snapshot_id for s in executed if s.chunk_seq in self._chunks]
        return known[-1] if known else ""


def _return(task: Task, seen: list[Step], executed: int) -> float | None:
    """Sum of the rewards, as if unseen states were worth the mean of those seen; None if there are none."""
    total = sum(_reward(task, step) for step in seen)
    if not seen:
        return None if executed else _rounded(total)
    return _rounded(total if len(seen) == executed else total * executed / len(seen))


def _reward(task: Task, step: Step) -> float:
    return float(task.env_reward(step.state.astype(np.float64), step.goal.astype(np.float64)))


def _rounded(value: Any) -> float:
    return round(float(value), _DIGITS)


def main_error(row: Row) -> tuple[str, float]:
    """Return what a task's error is called on a dashboard and its value: mm of the fingers, or rad."""
    if "error_mean_finger_m" in row:
        return "mm", row["error_mean_finger_m"] * 1e3
    return "rad", row["error_rotation_rad"]


@dataclass
class Scoreboard:
    """Running totals over the rows of a run, for the heartbeat."""

    newest: Row = field(default_factory=dict[str, Any])
    evaluation: list[Row] = field(default_factory=list[Row])  # of the newest evaluation
    counts: Counter[str] = field(default_factory=Counter[str])  # of all planned episodes

    def add(self, row: Row) -> None:
        """Account for one finished episode."""
        self.newest = row
        if row["mode"] == "evaluate":
            if row["index"] == 0:
                self.evaluation = []
            self.evaluation.append(row)
        if row["mode"] not in WARMUP_MODES:
            for name in ("planned", "late", "held"):
                self.counts[name] += row[name]

    def fields(self) -> dict[str, float]:
        """Return the numbers of the heartbeat; those that are not known yet are absent."""
        numbers = {"held": float(self.counts["held"])}
        if self.counts["planned"]:
            numbers["late_share"] = self.counts["late"] / self.counts["planned"]
        if self.newest:
            unit, error = main_error(self.newest)
            numbers[f"error_last_{unit}"] = error
            if "return" in self.newest:
                numbers["return_last"] = self.newest["return"]
        return numbers | _evaluation_fields(self.evaluation)


def _evaluation_fields(rows: list[Row]) -> dict[str, float]:
    if not rows:
        return {}
    unit = main_error(rows[0])[0]
    numbers = {
        "success_rate": _mean([row["success_paper"] for row in rows]),
        f"eval_error_{unit}": _mean([main_error(row)[1] for row in rows]),
    }
    returns = [row["return"] for row in rows if "return" in row]
    return numbers | ({"eval_return": _mean(returns)} if returns else {})


def _mean(values: list[Any]) -> float:
    return float(np.mean(values))


def row_of(labels: Mapping[str, Any], result: Row, **about: Any) -> Row:
    """Put a line of episodes.jsonl together: whose it is, which episode, how it went."""
    return {**labels, **about, **result}

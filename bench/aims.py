"""What our method is meant to reach on each task, and whether it does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from bench.outcomes import Outcome, Outcomes
from bench.stated import OURS, TASKS
from bench.summary import result_of
from deploy.scores import Row

MINUTES, EPISODES = 45.0, 100

Verdict = tuple[str, bool | None]  # what was measured, and whether that will do
_UNKNOWN: Verdict = ("–", None)


def aims(outcomes: Outcomes, ceilings: Mapping[str, Sequence[Row]]) -> list[tuple[str, str, str, str]]:
    """Task, aim, what was measured and whether it is met, of every aim."""
    rows: list[tuple[str, str, str, str]] = []
    for task, text, judge in _AIMS:
        found, ceiling = outcomes.get(task, {}), ceilings.get(task, ())
        measured, met = judge(found, ceiling) if OURS in found else _UNKNOWN
        rows.append((task, text, measured, {True: "yes", False: "no", None: "–"}[met]))
    return rows


def _reachable(found: Mapping[str, Outcome], _: Sequence[Row]) -> Verdict:
    rate = found[OURS].mean("success_reachable")
    return _UNKNOWN if rate is None else (f"{rate:.0%}", rate >= 0.90)


def _finger(found: Mapping[str, Outcome], ceiling: Sequence[Row]) -> Verdict:
    error_mm = found[OURS].mean("mean_finger_error_mm")
    if error_mm is None or not ceiling:
        return _UNKNOWN
    best_mm = 1e3 * result_of(ceiling)["error_mean_finger_m"]["mean"]
    return f"{error_mm:.2f} mm, held {best_mm:.2f} mm", error_mm <= best_mm + 1.0


def _return(found: Mapping[str, Outcome], ceiling: Sequence[Row]) -> Verdict:
    mine = found[OURS].mean("return_mean")
    if mine is None or not ceiling:
        return _UNKNOWN
    best = result_of(ceiling)["return"]["mean"]
    return f"{mine:.2f}, held {best:.2f}", mine >= 1.15 * best  # both are negative


def _rate(least: float) -> Callable[[Mapping[str, Outcome], Sequence[Row]], Verdict]:
    def judge(found: Mapping[str, Outcome], _: Sequence[Row]) -> Verdict:
        rate = found[OURS].mean("success_paper")
        return _UNKNOWN if rate is None else (f"{rate:.0%}", rate >= least)

    return judge


def _of_oracle(found: Mapping[str, Outcome], _: Sequence[Row]) -> Verdict:
    """Where the oracle hardly succeeds, errors are compared instead."""
    share, error = found[OURS].mean("success_of_ceiling"), found[OURS].mean("error_over_ceiling")
    if share is not None:
        return f"{share:.0%}", share >= 0.90
    return _UNKNOWN if error is None else (f"error {error:.2f} of the oracle's", error <= 1.1)


def _twice(found: Mapping[str, Outcome], _: Sequence[Row]) -> Verdict:
    rates = [found[label].mean("success_paper") for label in ("dpets", "pets") if label in found]
    mine, known = found[OURS].mean("success_paper"), [rate for rate in rates if rate is not None]
    if mine is None or not known:
        return _UNKNOWN
    return f"{mine:.0%}, theirs {max(known):.0%}", mine >= 2 * max(known) and mine > 0


def _minutes(found: Mapping[str, Outcome], _: Sequence[Row]) -> Verdict:
    ours = found[OURS]
    episodes = [row["episode"] for row in ours.finals if row.get("cpu_s")]
    if not ours.cpu_s or not any(episodes):
        return _UNKNOWN
    minutes = sum(ours.cpu_s.values()) / 60 * EPISODES * len(episodes) / sum(episodes)
    return f"{minutes:.0f} min", minutes <= MINUTES


_COST = f"{EPISODES} episodes, warm-up included, within {MINUTES:.0f} min of one core"
_AIMS = (
    ("reach", "at least 90 % of the goals whose held posture is within 2 mm", _reachable),
    ("reach", "mean finger error within 1 mm of the held postures'", _finger),
    ("reach", "return within 15 % of the held postures'", _return),
    ("egg", "success of at least 80 %, as the paper", _rate(0.80)),
    ("egg", "or 90 % of the oracle's; where that is under 10 %, its errors by a tenth", _of_oracle),
    ("egg_rotate", "success of at least 70 %, as the paper", _rate(0.70)),
    ("block", "success of at least 50 %", _rate(0.50)),
    ("block", "at least twice the success of the better of `dpets` and `pets`", _twice),
    *((task, _COST, _minutes) for task in TASKS),
)

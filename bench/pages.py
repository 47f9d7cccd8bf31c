"""The page of results: by task ours, the others, what the paper states, the ceiling, where ours is worse."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from bench.aims import aims
from bench.columns import BESIDE, CRITERIA, ERRORS, NONE, RETURN, Column, number, percent, seeds_of, span
from bench.figures import CURVES_FILE, SUCCESS_FILE
from bench.outcomes import Outcome, Outcomes
from bench.stated import COMPARED, EPISODE_STEPS, FURTHER, OURS, PAPER, SEEDS, TASKS, WARMUP_STEPS
from bench.studies import ablations, cost, steps
from bench.summary import result_line, result_of
from deploy.markdown import code, table
from deploy.scores import Row

_HEAD = f"""# Results

Made by `python -m bench.report` from `bench/results/*.jsonl` alone; do not edit. How the other methods were
made: [baselines.md](baselines.md). What was tried on the way: [learning_notes.md](learning_notes.md).

The same protocol for all: {WARMUP_STEPS} warm-up samples, episodes of {EPISODE_STEPS} steps, held-out goals
(20 at the points of a curve, 100 at the end), seeds {", ".join(map(str, SEEDS))}. `{OURS}` is ours,
`gc_pmpc` the paper's loss, horizon and optimiser with fewer candidates; both are asynchronous with
x = 2. The others decide while the plant stands still. Successes are of all seeds' goals together, with
Wilson's 95 % interval; other numbers are means over seeds ± sample deviation. {NONE}: there is none. CPU is
the processor time of training, without evaluations.
"""
_FIGURES = f"""## Figures

![Learning curves]({CURVES_FILE})

Goals that training never saw; mean and deviation over seeds, dashed with fewer than {len(SEEDS)} of them.

![Success]({SUCCESS_FILE})
"""


def page(outcomes: Outcomes, ceilings: Mapping[str, Sequence[Row]], case_studies: Sequence[str] = ()) -> str:
    """The whole page; `ceilings` are the committed references by task, `case_studies` files beside it."""
    parts = [
        _HEAD,
        "## In short\n\n" + headline(outcomes, ceilings),
        _coverage(outcomes),
        _FIGURES,
        "## Aims\n\n" + table(("task", "aim", "measured", "met"), aims(outcomes, ceilings)),
        *(_task(task, outcomes.get(task, {}), ceilings.get(task, ())) for task in TASKS),
        *(f"* A case study: [{name}]({name})\n" for name in case_studies),
        steps(outcomes.get("reach", {})),
        ablations(outcomes),
        cost(outcomes),
        _REPRODUCE,
    ]
    return "\n".join(parts)


def headline(outcomes: Outcomes, ceilings: Mapping[str, Sequence[Row]]) -> str:
    """Success by task: ours, the best other's, what the paper states, what the true simulator allows."""
    heads = ("task", code(OURS), "seeds, episodes", "best other", "the paper's", "true simulator")
    rows = (_headline_row(task, outcomes.get(task, {}), ceilings.get(task, ())) for task in TASKS)
    return table(heads, rows)


def _headline_row(task: str, found: Mapping[str, Outcome], ceiling: Sequence[Row]) -> tuple[str, ...]:
    ours, others = found.get(OURS), [found[label] for label in COMPARED if label in found and label != OURS]
    best = max(others, key=lambda other: other.mean("success_paper") or 0.0, default=None)
    stated = PAPER[task].success
    return (
        task,
        percent(ours.success("success_paper")) if ours else NONE,
        f"{len(ours.runs)}, {span(row['episode'] for row in ours.finals)}" if ours else NONE,
        f"{code(best.label)} {percent(best.success('success_paper'))}" if best else NONE,
        NONE if stated is None else f"{stated:.0%}",
        f"{result_of(ceiling)['success_paper']['rate']:.0%} of {len(ceiling)}" if ceiling else NONE,
    )


# --- what there is ----------------------------------------------------------------------------------


def _coverage(outcomes: Outcomes) -> str:
    rows = (
        (code(label), *(seeds_of(outcomes.get(task, {}).get(label)) for task in TASKS)) for label in COMPARED
    )
    return "## Seeds that have been run\n\n" + table(("method", *TASKS), rows)


# --- a task -----------------------------------------------------------------------------------------


def _task(task: str, found: Mapping[str, Outcome], ceiling: Sequence[Row]) -> str:
    columns = (RETURN, *ERRORS[task])
    heads = ("method", "seeds", "episodes", "goals", *CRITERIA[task].values(), *BESIDE[task].values())
    labels = [*COMPARED, *(label for label in FURTHER if label in found)]
    rows = (_method_row(task, label, found.get(label)) for label in labels)
    return "\n".join(
        [
            f"## {task}\n",
            f"* The paper: {PAPER[task].text}.",
            f"* The true simulator, {_ceiling(ceiling)}\n",
            table((*heads, *(column.heading for column in columns), "CPU, min"), rows),
            f"Where `{OURS}` is worse:\n",
            *(f"* {line}" for line in _worse(task, found, ceiling)),
            "",
        ]
    )


def _method_row(task: str, label: str, outcome: Outcome | None) -> tuple[str, ...]:
    if outcome is None:
        columns = 3 + len(CRITERIA[task]) + len(BESIDE[task]) + 1 + len(ERRORS[task]) + 1
        return (code(label), *[NONE] * columns)
    return (
        code(label),
        seeds_of(outcome),
        span(row["episode"] for row in outcome.finals),
        span(row["goals"] for row in outcome.finals),
        *(percent(outcome.success(criterion)) for criterion in CRITERIA[task]),
        *(number(outcome, Column(key, "", 2, +1)) for key in BESIDE[task]),
        *(number(outcome, column) for column in (RETURN, *ERRORS[task])),
        NONE if outcome.cpu_s is None else f"{sum(outcome.cpu_s.values()) / 60:.0f}",
    )


def _ceiling(rows: Sequence[Row]) -> str:
    if not rows:
        return "what is possible there: not measured."
    how = (
        "best held posture" if rows[0]["budget"] == "held" else f"the oracle with budget {rows[0]['budget']}"
    )
    return f"{how}, {len(rows)} goals: {result_line(result_of(rows))}."


def _worse(task: str, found: Mapping[str, Outcome], ceiling: Sequence[Row]) -> list[str]:
    """Every number in which another method, the paper or the true simulator is better."""
    ours = found.get(OURS)
    if ours is None:
        return ["there is no run of it yet."]
    lines = [
        line
        for label in (*COMPARED, *FURTHER)
        if label in found
        for line in _better(task, found[label], ours)
    ]
    success = ours.success("success_paper")
    assert success is not None
    stated = PAPER[task].success
    if stated is not None and success.rate < stated:
        lines.append(f"the paper states a success of {stated:.0%}, ours is {success.rate:.0%}.")
    if ceiling and success.rate < (best := result_of(ceiling)["success_paper"]["rate"]):
        lines.append(
            f"the true simulator allows {best:.0%} on {len(ceiling)} goals, ours is {success.rate:.0%}."
        )
    return lines or ["nowhere, of what has been run."]


def _better(task: str, other: Outcome, ours: Outcome) -> Iterator[str]:
    paper = Column("success_paper", "success", 2, +1)
    counted = ERRORS[task] if task == "egg" else ERRORS[task][:1]
    for column in (paper, RETURN, *counted):
        theirs, mine = other.mean(column.key), ours.mean(column.key)
        if theirs is not None and mine is not None and column.sign * (theirs - mine) > 0:
            both = f"{number(other, column)}, ours {number(ours, column)}"
            yield f"{code(other.label)}: {column.heading} {both}."


_REPRODUCE = """## Any single row again

```sh
python -m bench.sweep bench/sweeps/baselines.yaml --only reach/td7/0   # TASK/METHOD/SEED
python -m bench.report --collect runs/baselines                        # into bench/results
python -m bench.report                                                 # this page
```

The sweeps are `ours.yaml`, `baselines.yaml` and `ablations.yaml`; a row's `commit` tells which code made it.
"""

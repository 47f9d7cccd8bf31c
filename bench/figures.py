"""The pictures of the comparison: learning curves, success, and return over steps on reach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from bench.outcomes import Outcome, Outcomes
from bench.run_curves import over_seeds
from bench.stated import COMPARED, EPISODE_STEPS, FURTHER, OURS, PAPER, RETURN_BAR, SEEDS, TASKS, WARMUP_STEPS

CURVES_FILE, SUCCESS_FILE, STEPS_FILE = "learning_curves.png", "success.png", "reach_steps.png"
ROWS_KEY = "Rows"  # a text in each picture: digest of the rows that it shows

_DPI = 100
_LONGEST_EPISODES = 200  # longer runs are in the picture of steps
_COLOURS = dict(
    zip((*COMPARED, *FURTHER), ("C3", "C1", "C0", "C9", "C2", "C4", "C5", "C7", "k", "C5", "C4"), strict=True)
)
_NAMES = {**COMPARED, **FURTHER}
_SHORT = {label: name for label, name in _NAMES.items() if not label.endswith("_long")}


def draw_figures(outcomes: Outcomes, ceilings: Mapping[str, float], digest: str, out: Path) -> None:
    """Draw all pictures into the folder `out`; `ceilings` is the best known success by task."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    drawn = {
        CURVES_FILE: _learning_curves(plt, outcomes),
        SUCCESS_FILE: _success(plt, outcomes, ceilings),
        STEPS_FILE: _steps(plt, outcomes),
    }
    for name, figure in drawn.items():
        figure.savefig(out / name, dpi=_DPI, metadata={ROWS_KEY: digest, "Software": None})
        plt.close(figure)


def digest_of(picture: Path) -> str:
    """Which rows a picture shows; empty if there is no such picture."""
    from PIL import Image

    if not picture.exists():
        return ""
    with Image.open(picture) as image:
        return str(image.info.get(ROWS_KEY, ""))


def _shown(outcomes: Outcomes, task: str, labels: Mapping[str, str]) -> Iterator[Outcome]:
    return (outcomes[task][label] for label in labels if label in outcomes.get(task, {}))


# --- learning curves --------------------------------------------------------------------------------


def _learning_curves(plt: Any, outcomes: Outcomes) -> Any:
    size = (4.0 * len(TASKS), 6.4)
    figure, axes = plt.subplots(
        2, len(TASKS), figsize=size, squeeze=False, layout="constrained", sharex="col"
    )
    for column, task in zip(axes.T, TASKS, strict=True):
        for axis, name, factor in zip(column, ("return_mean", "success_paper"), (1.0, 100.0), strict=True):
            for outcome in _shown(outcomes, task, _SHORT):
                _draw_curve(axis, outcome, name, factor)
            _tidy(axis)
        column[0].set_title(task, fontsize=11)
        column[1].set_ylim(-4.0, 104.0)
        column[1].set_xlim(0, _LONGEST_EPISODES)
        column[1].set_xlabel("training episodes of 50 steps", fontsize=9)
        if task not in outcomes:
            column[0].text(0.5, 0.5, "no run yet", transform=column[0].transAxes, ha="center", color="0.5")
    axes[0, 0].set_ylabel("held-out return", fontsize=9)
    axes[1, 0].set_ylabel("held-out success, the paper's bar, %", fontsize=9)
    _legend(figure, axes)
    return figure


def _draw_curve(axis: Any, outcome: Outcome, name: str, factor: float) -> None:
    """Mean and deviation over seeds; dashed with fewer seeds than there should be."""
    x, mean, deviation = over_seeds(outcome.curves(name))
    kept = x <= _LONGEST_EPISODES
    x, mean, deviation = x[kept], factor * mean[kept], factor * deviation[kept]
    width = 2.4 if outcome.label == OURS else 1.4
    colour = _COLOURS[outcome.label]
    style = "-" if len(outcome.runs) >= len(SEEDS) else "--"
    axis.plot(
        x, mean, style, color=colour, linewidth=width, marker="o", markersize=3, label=_NAMES[outcome.label]
    )
    if len(outcome.runs) > 1:
        axis.fill_between(x, mean - deviation, mean + deviation, color=colour, alpha=0.15, linewidth=0)


# --- success ----------------------------------------------------------------------------------------


_LEVELS = {"the paper's GC-PMPC": "--", "the best of the paper's others": ":", "true simulator": "-."}


def _success(plt: Any, outcomes: Outcomes, ceilings: Mapping[str, float]) -> Any:
    size = (4.0 * len(TASKS), 4.0)
    figure, axes = plt.subplots(1, len(TASKS), figsize=size, layout="constrained", sharey=True)
    for axis, task in zip(axes, TASKS, strict=True):
        for place, label in enumerate(COMPARED):
            _draw_bar(axis, place, outcomes.get(task, {}).get(label))
        axis.set_xticks(range(len(COMPARED)), COMPARED.values(), rotation=40, ha="right", fontsize=8)
        axis.set_title(task, fontsize=11)
        axis.set_ylim(0.0, 104.0)
        _tidy(axis)
        levels = (PAPER[task].success, PAPER[task].others, ceilings.get(task))
        for (name, style), rate in zip(_LEVELS.items(), levels, strict=True):
            axis.axhline(
                nan if rate is None else 100.0 * rate, color="k", linestyle=style, linewidth=1.2, label=name
            )
        axis.set_xlim(-0.6, len(COMPARED) - 0.4)
    axes[0].set_ylabel("success at the paper's bar, %; Wilson 95 %", fontsize=9)
    _legend(figure, axes)
    return figure


def _draw_bar(axis: Any, place: int, outcome: Outcome | None) -> None:
    success = outcome.success("success_paper") if outcome else None
    if outcome is None or success is None:
        axis.text(place, 2.0, "no run", rotation=90, ha="center", va="bottom", fontsize=8, color="0.5")
        return
    rate = 100.0 * success.rate
    low, high = (100.0 * bound for bound in success.interval)
    axis.bar(place, rate, color=_COLOURS[outcome.label], width=0.7, alpha=0.85)
    axis.errorbar(place, rate, yerr=[[rate - low], [high - rate]], color="k", capsize=3, linewidth=1)
    axis.text(place, min(high + 2.0, 98.0), f"{rate:.0f}", ha="center", fontsize=8)


# --- steps ------------------------------------------------------------------------------------------


def _steps(plt: Any, outcomes: Outcomes) -> Any:
    figure, axis = plt.subplots(figsize=(8.0, 4.0), layout="constrained")
    for outcome in _shown(outcomes, "reach", _NAMES):
        episodes, mean, _ = over_seeds(outcome.curves("return_mean"))
        steps = WARMUP_STEPS + EPISODE_STEPS * episodes
        style = "--" if outcome.label in FURTHER else "-"
        axis.plot(
            steps,
            mean,
            style,
            color=_COLOURS[outcome.label],
            marker="o",
            markersize=3,
            label=_NAMES[outcome.label],
        )
    axis.axhline(RETURN_BAR, color="0.35", linestyle=":", linewidth=1)
    axis.set_xscale("log")
    axis.set_xlim(0.9 * WARMUP_STEPS, 4e5)
    axis.text(3.9e5, RETURN_BAR, f"{RETURN_BAR}", ha="right", va="bottom", fontsize=8, color="0.35")
    axis.set_xlabel(f"steps in the environment, {WARMUP_STEPS} of warm-up included", fontsize=9)
    axis.set_ylabel("held-out return on reach", fontsize=9)
    _tidy(axis)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def _tidy(axis: Any) -> None:
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.25)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def _legend(figure: Any, axes: Any) -> None:
    found: dict[str, Any] = {}
    for axis in np.ravel(axes):
        handles, names = axis.get_legend_handles_labels()
        found.update(zip(names, handles, strict=True))
    order = [name for name in (*_NAMES.values(), *_LEVELS) if name in found]
    if order:
        figure.legend(
            [found[name] for name in order],
            order,
            loc="outside lower center",
            ncols=len(order),
            fontsize=9,
            frameon=False,
        )

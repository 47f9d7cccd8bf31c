"""Learning curves of run directories: methods side by side, mean and deviation over seeds, as one picture."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.curriculum_files import read_rows
from deploy.scores import Row, main_error

SMOOTH = 10  # episodes in the running mean of the training return
_WIDTH_IN, _HEIGHT_IN, _DPI = 4.2, 3.1, 110

Curve = Mapping[int, float]  # training episodes → value
Runs = Mapping[str, Sequence[Sequence[Row]]]  # method → rows of each seed


def draw_runs(directories: Sequence[Path], out: Path) -> None:
    """Draw evaluation error, success and training return of the runs; one row of panels per task."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    tasks = _grouped(directories)
    size = (3 * _WIDTH_IN, len(tasks) * _HEIGHT_IN)
    figure, axes = plt.subplots(len(tasks), 3, figsize=size, squeeze=False, layout="constrained")
    for row, (task, runs) in zip(axes, tasks.items(), strict=True):
        _draw_task(row, task, runs)
    figure.savefig(out, dpi=_DPI)
    plt.close(figure)


def _grouped(directories: Sequence[Path]) -> dict[str, dict[str, list[list[Row]]]]:
    tasks: dict[str, dict[str, list[list[Row]]]] = defaultdict(lambda: defaultdict(list))
    for directory in directories:
        rows = read_rows(directory)
        if rows:
            tasks[rows[0]["task"]][rows[0].get("method", directory.name)].append(rows)
    if not tasks:
        raise FileNotFoundError("none of the runs has a finished episode")
    return tasks


def _draw_task(axes: Sequence[Any], task: str, runs: Runs) -> None:
    rows = next(iter(runs.values()))[0]
    unit = main_error(rows[0])[0]
    panels: tuple[tuple[str, Callable[[Sequence[Row]], Curve]], ...] = (
        (f"held-out final error, {unit}", lambda rows: evaluated(rows, lambda row: main_error(row)[1])),
        (
            "held-out success, paper's bar, %",
            lambda rows: evaluated(rows, lambda row: 100.0 * row["success_paper"]),
        ),
        (f"training return, mean of {SMOOTH}", trained),
    )
    for axis, (title, curve) in zip(axes, panels, strict=True):
        for colour, (method, seeds) in enumerate(runs.items()):
            _draw_curve(axis, [curve(rows) for rows in seeds], f"{method}, n = {len(seeds)}", f"C{colour}")
        axis.set_title(f"{task}: {title}", fontsize=9)
        axis.set_xlabel("training episodes", fontsize=8)
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylim(bottom=0.0)
    axes[1].set_ylim(-4.0, 104.0)
    axes[0].legend(fontsize=8, frameon=False)


def _draw_curve(axis: Any, curves: Sequence[Curve], label: str, colour: str) -> None:
    x, mean, deviation = over_seeds(curves)
    marker = "o" if len(x) <= 20 else ""
    axis.plot(x, mean, color=colour, label=label, marker=marker, markersize=3.5, linewidth=1.6)
    if len(curves) > 1:
        axis.fill_between(x, mean - deviation, mean + deviation, color=colour, alpha=0.18, linewidth=0)


def over_seeds(curves: Sequence[Curve]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return x, mean and deviation (n,) where every seed has a value: an unfinished one ends the curve."""
    common = sorted(set.intersection(*(set(curve) for curve in curves)))
    values = np.array([[curve[x] for x in common] for curve in curves]).reshape(len(curves), len(common))
    return np.array(common), values.mean(axis=0), values.std(axis=0)


def evaluated(rows: Sequence[Row], value: Callable[[Row], float]) -> Curve:
    """Return the mean over the goals of each evaluation."""
    at: dict[int, list[float]] = defaultdict(list)
    for row in rows:
        if row["mode"] == "evaluate":
            at[row["trained_episodes"]].append(value(row))
    return {episodes: float(np.mean(values)) for episodes, values in at.items()}


def trained(rows: Sequence[Row]) -> Curve:
    """Return the running mean of the training return; an incomplete episode counts as none."""
    done = [
        (row["trained_episodes"] + 1, row["return"])
        for row in rows
        if row["mode"] == "plan" and "return" in row
    ]
    values = [value for _, value in done]
    return {x: float(np.mean(values[max(0, i + 1 - SMOOTH) : i + 1])) for i, (x, _) in enumerate(done)}

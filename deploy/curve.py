"""`python -m deploy.curve RUN_DIR`: draw the learning curve of a run.

The curriculum writes its rows: one JSON object an episode.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from common.messages import WARMUP_MODES

EPISODES_FILE = "episodes.jsonl"
CURVE_FILE = "learning_curve.png"
SMOOTH = 10  # episodes in the running mean
Rows = Sequence[Mapping[str, Any]]


def read_episodes(path: Path) -> list[dict[str, Any]]:
    """Read the rows; none when there is no file, and a last line cut short by a crash is left out."""
    if not path.is_file():
        return []
    found: list[dict[str, Any]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def error_keys(rows: Rows) -> list[str]:
    """Name the final errors that the rows hold, such as `error_mean_finger_m`."""
    return sorted({key for row in rows for key in row if key.startswith("error_")})


def success_keys(rows: Rows) -> list[str]:
    """Name the criteria of success that the rows hold, such as `success_paper`."""
    return sorted({key for row in rows for key in row if key.startswith("success_")})


def in_people_units(key: str, value: float) -> tuple[str, float]:
    """Turn metres into millimetres and radians into degrees: (label, value)."""
    name, _, unit = key.removeprefix("error_").rpartition("_")
    label, factor = {"m": ("mm", 1000.0), "rad": ("°", 180.0 / math.pi)}.get(unit, (unit, 1.0))
    return f"{name.replace('_', ' ')}, {label}".removeprefix(", "), value * factor


def mean(key: str, rows: Rows) -> float | None:
    """Average of what the rows hold under a key, in people's units; None when they hold nothing."""
    values = [float(row[key]) for row in rows if row.get(key) is not None]
    if not values:
        return None
    average = sum(values) / len(values)
    return in_people_units(key, average)[1] if key.startswith("error_") else average


def draw(rows: Rows, path: Path) -> bool:
    """Save return and final errors over training episodes as a PNG; False when there is nothing to draw."""
    planned = [row for row in rows if row.get("mode") not in WARMUP_MODES]
    if not planned:
        return False
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    keys = ["return", *error_keys(planned)]
    figure, axes = plt.subplots(len(keys), 1, sharex=True, figsize=(7.0, 2.2 * len(keys)), squeeze=False)
    for axis, key in zip(axes[:, 0], keys, strict=True):
        _draw_one(axis, planned, key)
    axes[0, 0].legend()
    axes[-1, 0].set_xlabel("training episodes")
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)
    return True


def _draw_one(axis: Any, rows: Rows, key: str) -> None:
    learning = [row for row in rows if row["mode"] != "evaluate" and row.get(key) is not None]
    values = [mean(key, [row]) or 0.0 for row in learning]
    trained = [row["trained_episodes"] for row in learning]
    axis.plot(trained, values, ".", color="0.7", markersize=4)
    axis.plot(trained, running_mean(values), label=f"learning, mean of {SMOOTH}")
    evaluated = [row for row in rows if row["mode"] == "evaluate"]
    rounds = sorted({row["trained_episodes"] for row in evaluated})
    means = [mean(key, [row for row in evaluated if row["trained_episodes"] == at]) for at in rounds]
    axis.plot(rounds, [math.nan if value is None else value for value in means], "k.-", label="evaluation")
    axis.set_ylabel("return" if key == "return" else in_people_units(key, 0.0)[0], fontsize=8)
    axis.grid(alpha=0.3)


def running_mean(values: Sequence[float], width: int = SMOOTH) -> list[float]:
    """Mean over up to `width` values that end at each place."""
    windows = [values[max(0, i + 1 - width) : i + 1] for i in range(len(values))]
    return [sum(window) / len(window) for window in windows]


def main(arguments: list[str]) -> int:
    """Draw the curve of each run directory; 1 if one of them has nothing to draw."""
    failed = not arguments
    for run_dir in map(Path, arguments):
        drawn = draw(read_episodes(run_dir / EPISODES_FILE), run_dir / CURVE_FILE)
        print(run_dir / CURVE_FILE if drawn else f"{run_dir}: no planned episode in {EPISODES_FILE}")
        failed |= not drawn
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

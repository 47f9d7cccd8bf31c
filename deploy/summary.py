"""What a finished or interrupted `run` leaves on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from deploy.cell import Cell
from deploy.curve import (
    CURVE_FILE,
    EPISODES_FILE,
    error_keys,
    in_people_units,
    mean,
    read_episodes,
    success_keys,
)
from deploy.monitor import Heard
from deploy.progress import MISSING

LAST = 10  # episodes that the summary averages
PLANTS = ("hand_io", "sim")
COUNTS = ("planned", "late", "held")
FILES = {"checkpoint": "learner/checkpoint.safetensors", "recording": "*.rrd", "learning curve": CURVE_FILE}


def summarise(cell: Cell, heard: Mapping[str, Heard], say: Callable[[str], None]) -> None:
    """Print what the run has reached, how well it kept time, and where its files are."""
    for line in (*summary(cell.run_dir), *timing(read_episodes(cell.run_dir / EPISODES_FILE), heard)):
        say(line)
    for name, pattern in FILES.items():
        say(f"{name:15}{newest(cell.run_dir, pattern) or 'none yet'}")


def summary(run_dir: Path) -> list[str]:
    """Lay out the means over the last episodes, a column per mode."""
    episodes = read_episodes(run_dir / EPISODES_FILE)
    modes = list(dict.fromkeys(str(row["mode"]) for row in episodes))
    columns = [[row for row in episodes if row["mode"] == mode] for mode in modes]
    lines = [
        _line(f"mean of the last {LAST}", modes),
        _line("episodes", [str(len(column)) for column in columns]),
    ]
    for key in ("return", *error_keys(episodes), *success_keys(episodes)):
        lines.append(_line(_label(key), [_figure(key, mean(key, column[-LAST:])) for column in columns]))
    return lines if episodes else ["no episode was finished"]


def timing(episodes: Sequence[Mapping[str, Any]], heard: Mapping[str, Heard]) -> list[str]:
    """Say how the planned steps of all sessions kept time, and what the services report of this one."""
    planned, late, held = (sum(int(row.get(key, 0)) for row in episodes) for key in COUNTS)
    plant, planner, learner = (_fields_of(heard, names) for names in (PLANTS, ("planner",), ("learner",)))
    session = (
        *_phrases(plant, missed_ticks="{:.0f} missed ticks"),
        *_phrases(planner, plan_ms_p50="plans {:.0f} ms p50", plan_ms_p99="{:.0f} p99"),
        *_phrases(learner, updates="{:.0f} updates", updates_per_s="{:.1f} a second while training"),
    )
    shares = f"{late} late ({late / max(planned, 1):.1%}), {held} held ({held / max(planned, 1):.1%})"
    lines = [f"{'planned steps':15}{planned}: {shares}"] if planned else []
    return [*lines, f"{'this session':15}{', '.join(session)}"] if session else lines


def _fields_of(heard: Mapping[str, Heard], names: Sequence[str]) -> Mapping[str, float]:
    return next((heard[name].health.fields for name in names if name in heard), {})


def _phrases(fields: Mapping[str, float], **forms: str) -> list[str]:
    return [form.format(fields[key]) for key, form in forms.items() if key in fields]


def _line(label: str, values: list[str]) -> str:
    return "".join((f"{label:24}", *(f"{value:>10}" for value in values)))


def _label(key: str) -> str:
    return in_people_units(key, 0.0)[0] if key.startswith("error_") else key.replace("_", " ")


def _figure(key: str, value: float | None) -> str:
    if value is None:
        return MISSING
    return f"{value:.0%}" if key.startswith("success_") else f"{value:.3g}"


def newest(directory: Path, pattern: str) -> Path | None:
    """Return the file that was written last."""
    return max(directory.glob(pattern), key=lambda path: path.stat().st_mtime, default=None)

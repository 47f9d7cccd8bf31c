"""What `run` shows while a cell learns, and its summary at the end."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table

from common.messages import Metrics
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

LINE_EVERY_S = 15.0  # without a terminal, even when no episode ended
LAST = 10  # episodes that the summary averages
MISSING = "–"
FILES = {"checkpoint": "learner/checkpoint.safetensors", "recording": "*.rrd", "learning curve": CURVE_FILE}
Fields = Mapping[str, float]


def figures(heard: Mapping[str, Heard], metrics: Metrics | None) -> dict[str, str]:
    """Collect what people want to see; what nobody reports yet is shown as missing."""
    curriculum, planner, learner = (_fields(heard, name) for name in ("curriculum", "planner", "learner"))
    plant = _fields(heard, "hand_io") or _fields(heard, "sim")
    shown = {
        "phase": heard["curriculum"].health.state if "curriculum" in heard else MISSING,
        "episode": f"{_number(curriculum, 'episode')}/{_number(curriculum, 'episodes_total')}",
        "return": _number(curriculum, "return_last", ".2f"),
        "error": _error(curriculum),
        "success": _percent(curriculum, "success_rate"),
        "plan ms": f"{_number(planner, 'plan_ms_p50')}/{_number(planner, 'plan_ms_p99')}",
        "late": f"{_number(plant, 'late_steps')} ({_percent(curriculum, 'late_share')})",
        "loss": _number(learner, "loss_total", ".3g"),
        "model": f"{metrics.snapshot_id[:8]} ({metrics.updates} updates)" if metrics else MISSING,
        "eta": _duration(curriculum.get("eta_s")),
    }
    return shown


def _fields(heard: Mapping[str, Heard], name: str) -> Fields:
    return heard[name].health.fields if name in heard else {}


def _number(fields: Fields, key: str, form: str = ".0f") -> str:
    return format(fields[key], form) if key in fields else MISSING


def _percent(fields: Fields, key: str) -> str:
    return f"{fields[key]:.0%}" if key in fields else MISSING


def _error(fields: Fields) -> str:
    for key, unit in (("error_last_mm", "mm"), ("error_last_rad", "rad")):
        if key in fields:
            return f"{fields[key]:.3g} {unit}"
    return MISSING


def _duration(seconds: float | None) -> str:
    if seconds is None or seconds < 0:
        return MISSING
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min {rest:02d} s"


class Display:
    """Live table in a terminal; one line an episode elsewhere. A context manager."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._console = Console()
        self._live = Live(console=self._console, auto_refresh=False) if sys.stdout.isatty() else None
        self._last_line = ("", 0.0)

    def __enter__(self) -> Display:
        """Begin."""
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last state standing."""
        if self._live:
            self._live.stop()

    def say(self, text: str) -> None:
        """Print one line above the table."""
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def show(self, shown: Mapping[str, str]) -> None:
        """Bring the display up to date."""
        if self._live:
            self._live.update(self._table(shown), refresh=True)
            return
        episode, at = self._last_line
        if shown["episode"] != episode or time.monotonic() - at > LINE_EVERY_S:
            self._last_line = (shown["episode"], time.monotonic())
            self.say("  ".join(f"{name} {value}" for name, value in shown.items()))

    def _table(self, shown: Mapping[str, str]) -> Table:
        table = Table(title=self._title, title_justify="left", show_header=False)
        for name, value in shown.items():
            table.add_row(name, value)
        return table


def summarise(cell: Cell, say: Callable[[str], None]) -> None:
    """Print what the run has reached and where its files are."""
    for line in summary(cell.run_dir):
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

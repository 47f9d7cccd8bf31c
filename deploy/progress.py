"""What `run` shows while a cell learns."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

from rich.console import Console
from rich.live import Live
from rich.table import Table

from common.messages import Metrics
from deploy.monitor import Heard

LINE_EVERY_S = 15.0  # without a terminal, even when no episode ended
MISSING = "–"
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

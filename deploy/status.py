"""The health table: one row per process, from supervisord and from what is heard on the bus."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from deploy.monitor import Heard
from deploy.processes import process_of
from deploy.supervisor_client import ProcessInfo

_SPAWNED = re.compile(r"spawned: '([^']+)' with pid")
_STARTED = "supervisord started with pid"


@dataclass(frozen=True)
class Row:
    """One process as `status` shows it; `problem` is empty when all is well."""

    name: str
    cells: tuple[str, ...]
    problem: str


HEADINGS = (
    "service", "process", "state", "age s", "loop ms p50/p99", "overruns", "stale", "refused", "dropped",
    "restarts", "MB", "",
)  # fmt: skip


# What went wrong and was survived: counted by the process named first, since its start.
TALLIES = (
    ("sim", "held_steps"),
    ("sim", "late_steps"),
    ("sim", "missed_ticks"),
    ("sim", "abandoned_episodes"),
    ("sim", "unacknowledged"),
    ("hand_io", "held_steps"),
    ("hand_io", "late_steps"),
    ("hand_io", "missed_ticks"),
    ("hand_io", "abandoned_episodes"),
    ("hand_io", "faults"),
    ("hand_io", "late_cycles"),
    ("learner", "incomplete_episodes"),
    ("curriculum", "lost_episodes"),
)


def rows(
    instances: Sequence[str],
    infos: Mapping[str, ProcessInfo],
    heard: Mapping[str, Heard],
    config_hash: str,
    restarts: Mapping[str, int],
) -> list[Row]:
    """Describe each process; those of other machines have no entry in `infos`."""
    return [
        _row(
            name, infos.get(name), heard.get(name), config_hash, str(restarts[name]) if name in infos else "-"
        )
        for name in instances
    ]


def _row(name: str, info: ProcessInfo | None, heard: Heard | None, config_hash: str, restarts: str) -> Row:
    problem = _problem(name, info, heard, config_hash)
    state = info.state.lower() if info else "elsewhere"
    if heard is None:
        return Row(name, (name, state, *["-"] * 7, restarts, "-", problem), problem)
    health = heard.health
    figures = (
        health.state[:40],
        f"{heard.age_s:.1f}",
        f"{health.loop_p50_ms:.1f}/{health.loop_p99_ms:.1f}",
        str(health.overruns),
        " ".join(health.stale_inputs) or "-",
        str(sum(health.refused.values())),
        str(sum(health.dropped.values())),
        restarts,
        f"{health.rss_mb:.0f}",
    )
    return Row(name, (name, state, *figures, problem), problem)


def _problem(name: str, info: ProcessInfo | None, heard: Heard | None, config_hash: str) -> str:
    if info is not None and info.finished:
        return ""
    if info is not None and not info.alive:
        return f"NOT RUNNING ({info.reason or 'stopped'})"
    if heard is None:
        return "NOT HEARD" if process_of(name).heartbeat else ""
    if not heard.fresh:
        return f"SILENT for {heard.age_s:.0f} s"
    if heard.health.config_hash != config_hash:
        return f"OTHER CONFIG {heard.health.config_hash or '(none)'}"
    return ""


def table(found: Sequence[Row]) -> str:
    """Lay the rows out in columns."""
    lines = [HEADINGS, *(row.cells for row in found)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADINGS))]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def tallies(heard: Mapping[str, Heard]) -> str:
    """Lay out what was survived, in one line; what nobody reports is left out."""
    reported = [(field, heard[name].health.fields.get(field)) for name, field in TALLIES if name in heard]
    return "  ".join(f"{field} {count:.0f}" for field, count in reported if count is not None)


def restarts(supervisor_log: Path) -> Counter[str]:
    """Count how often each process was started again since supervisord began, from its log."""
    try:
        text = supervisor_log.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return Counter()
    spawned = Counter(_SPAWNED.findall(text.rpartition(_STARTED)[2]))
    return Counter({name: count - 1 for name, count in spawned.items()})

"""Committed results: rows of finished runs in bench/results/<task>.jsonl, one run a task, label and seed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.methods import METHODS, configure
from bench.references import RESULTS
from bench.result_rows import SESSIONS_FILE, results_of, trained_episodes
from bench.summary import json_lines
from common.config import ConfigError, read_yaml
from common.task import TASKS
from deploy.curriculum_files import ROWS_FILE, read_rows
from deploy.scores import Row

CONFIG_FILE = "config.yaml"  # of bench.run
# What runs of one method may differ in.
_ANY = re.compile(r"seed|run_dir|config_hash|log\..*|curriculum\.(episodes|evaluate_\w+)")


class Refused(Exception):  # noqa: N818 - reads as what happened
    """A run that is not collected; the text says why."""


def collect(places: Iterable[Path], unfinished: bool = False, results: Path = RESULTS) -> list[str]:
    """Put the rows of all runs under `places` beside the committed ones; returns a line for each run.

    A run replaces the committed one of its task, label and seed, unless that has come further.
    """
    said: list[str] = []
    for directory in run_directories(places):
        try:
            rows = rows_of(directory, unfinished)
            said.append(f"{directory}: {_put(rows, results)}{_warning(directory, rows[0])}")
        except Refused as reason:
            said.append(f"{directory}: not collected: {reason}")
    return said


def run_directories(places: Iterable[Path]) -> list[Path]:
    """The runs of `bench.run` at or below these places, in order of their paths."""
    return sorted({file.parent for place in places for file in place.rglob(SESSIONS_FILE)})


def rows_of(directory: Path, unfinished: bool = False) -> list[Row]:
    """What is committed of a run: a row for each evaluation, and the one of most goals as its last.

    Raises Refused for a run that has not ended (unless asked for) or has other settings than a task's cell.
    """
    if not (directory / ROWS_FILE).exists():
        raise Refused("no finished episode")
    try:
        config = read_yaml(directory / CONFIG_FILE)
    except (ConfigError, OSError):
        raise Refused(f"{CONFIG_FILE} cannot be read") from None
    if config["cell"] != config["task"]:
        raise Refused(f"cell {config['cell']} is not the one of task {config['task']}")
    episodes = read_rows(directory)
    done, wanted = trained_episodes(episodes), config["curriculum"]["episodes"]
    if done < wanted and not unfinished:
        raise Refused(f"{done} of {wanted} episodes; --unfinished takes it as it is")
    whole = config["curriculum"]["evaluate_goals"]
    rows = [row for row in results_of(directory) if row["goals"] >= whole]
    if not rows:
        raise Refused("no complete evaluation")
    return rows


def differences(directory: Path, method: str) -> list[str]:
    """In which values a run differs from its method as it is now; newer options are left out."""
    config = read_yaml(directory / CONFIG_FILE)
    now = configure(config["task"], method, (), directory).model_dump(mode="json")
    ran, today = dict(_flat(config)), dict(_flat(now))
    return [name for name in today if name in ran and ran[name] != today[name] and not _ANY.fullmatch(name)]


def _flat(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _warning(directory: Path, row: Row) -> str:
    """A run under its method's own name should be that method."""
    if row["label"] != row["method"] or row["method"] not in METHODS:
        return ""
    found = differences(directory, row["method"])
    return f"; NOT {row['method']} as it is now: {', '.join(found)}" if found else ""


def _put(rows: Sequence[Row], results: Path) -> str:
    """Write the rows to their task's file. Raises Refused if the committed run has come further."""
    file = results / f"{rows[0]['task']}.jsonl"
    committed = json_lines(file)
    before = [row for row in committed if _run(row) == _run(rows[0])]
    if before and _extent(rows) < _extent(before):
        raise Refused(f"the committed run of this task, label and seed has come further; delete it in {file}")
    kept = [row for row in committed if _run(row) != _run(rows[0])]
    text = "".join(json.dumps(row) + "\n" for row in sorted([*kept, *rows], key=_order))
    file.write_text(text, encoding="utf-8")
    replaced = f", in place of {len(before)} of commit {before[-1]['commit']}" if before else ""
    return f"{len(rows)} rows{replaced}"


def _run(row: Row) -> tuple[str, str, int]:
    return row["task"], row["label"], row["seed"]


def _extent(rows: Sequence[Row]) -> tuple[int, int]:
    return max((row["episode"], row["goals"]) for row in rows)


def _order(row: Row) -> tuple[str, int, int, int]:
    return row["label"], row["seed"], row["episode"], row["goals"]


def committed_rows(results: Path = RESULTS) -> list[Row]:
    """All committed rows, the tasks in their order."""
    return [row for task in TASKS for row in json_lines(results / f"{task}.jsonl")]

"""Train one method on one task and seed in lock-step, with the services that run live.

    python -m bench.run --method gc_pmpc_plus --task reach --seed 0 --episodes 100 --out DIR

DIR receives config.yaml, episodes.jsonl (a line per episode), timing.jsonl (when each began, at what cost),
sessions.jsonl (commit, cores and versions of each start), the learner's data and checkpoints, results.jsonl
(a line per evaluation, the columns that methods are compared by), summary.json and curve.png.
Started again it goes on where it was. Returns, errors and goals depend on seed and configuration alone, also
after an interruption; time stamps and snapshot names do not survive one. Only an episode in the very instant
of being stored can be lost by a kill; it is counted in `lost_episodes`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column

from bench.cost import TIMING_FILE
from bench.lockstep_run import LockstepRun, Stalled, assemble
from bench.methods import METHODS, configure
from bench.provenance import provenance
from bench.result_rows import SESSIONS_FILE, rows_of_run
from bench.run_curves import draw_runs
from bench.summary import line, summarise
from common.config import ConfigError, read_yaml
from deploy.cell import Cell
from deploy.curriculum_files import ROWS_FILE, read_rows

CONFIG_FILE = "config.yaml"
SUMMARY_FILE = "summary.json"
RESULTS_FILE = "results.jsonl"
# What may change when a run is taken up again: nothing of it decides what is learned.
_EXTENDABLE = ("run_dir", "config_hash", "log")

REFRESH_S = 0.25
LINE_EVERY_S = 15.0  # without a terminal


class Watcher:
    """Shows how far the run is, and notes when each episode began."""

    def __init__(self, run: LockstepRun, directory: Path, session: int, bar: Progress) -> None:
        self._service = run.services["curriculum"]
        self._meter = run.meter
        self._timing = directory / TIMING_FILE
        self._session = session
        self._bar = bar
        self._task = bar.add_task("starting", total=None)
        self._begun_s = self._looked_s = self._shown_s = time.monotonic()
        self._episode = -1.0

    def __call__(self) -> None:
        """Look, at most every quarter of a second."""
        now_s = time.monotonic()
        if now_s - self._looked_s < REFRESH_S:
            return
        self._looked_s = now_s
        seen = self._service.report()
        if seen.fields["episode"] != self._episode:
            self._episode = seen.fields["episode"]
            self.note()
        if self._bar.console.is_terminal or now_s - self._shown_s >= LINE_EVERY_S:
            self._shown_s = now_s
            self._show(seen.state, seen.fields)

    def note(self) -> None:
        """Write down which episode is running, and what the session has cost until now."""
        wall_s = round(time.monotonic() - self._begun_s, 2)
        row = {"session": self._session, "episode": int(self._episode), "wall_s": wall_s}
        row["cpu_s"] = self._meter.read()
        with self._timing.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def _show(self, state: str, fields: Mapping[str, float]) -> None:
        text = f"{state}{_figures(fields)}"
        done, total = max(0.0, fields["episode"]), fields["episodes_total"]
        self._bar.update(self._task, description=text, completed=done, total=round(total))
        if not self._bar.console.is_terminal:
            self._bar.console.print(
                f"episode {done:.0f}/{total:.0f}  {text}", highlight=False, soft_wrap=True
            )


def _figures(fields: Mapping[str, float]) -> str:
    shown = {
        "return_last": "return {:.2f}",
        "eval_error_mm": "held-out {:.1f} mm",
        "eval_error_rad": "held-out {:.2f} rad",
        "success_rate": "success {:.0%}",
    }
    parts = [form.format(fields[name]) for name, form in shown.items() if name in fields]
    return "".join(f", {part}" for part in parts)


def train(cell: Cell, method: str, directory: Path, log: bool = False) -> dict[str, Any]:
    """Run the cell to its end, going on where `directory` was left; returns the summary.

    Raises ConfigError if the directory holds another run, Stalled if nothing moves any more.
    """
    directory.mkdir(parents=True, exist_ok=True)
    _claim(cell, directory)
    session = _begin_session(directory, method)
    before = read_rows(directory) if (directory / ROWS_FILE).exists() else []
    run = assemble(
        cell,
        labels={"method": method},
        log_dir=directory / "log" / f"{session:03d}" if log else None,
        start_ns=before[-1]["t_ns"] if before else 0,
    )
    with _progress() as bar:
        watcher = Watcher(run, directory, session, bar)
        try:
            run.drive(watcher)
        finally:
            watcher.note()
    summary = summarise(directory)
    (directory / SUMMARY_FILE).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    results = "".join(json.dumps(row) + "\n" for row in rows_of_run(directory))
    (directory / RESULTS_FILE).write_text(results, encoding="utf-8")
    return summary


def _claim(cell: Cell, directory: Path) -> None:
    """Keep the configuration beside its results, and refuse to mix two."""
    path = directory / CONFIG_FILE
    if path.exists() and not _same(cell, read_yaml(path)):
        raise ConfigError([f"{directory}: holds a run with another configuration; choose another --out"])
    path.write_text(yaml.safe_dump(cell.model_dump(mode="json"), sort_keys=False), encoding="utf-8")


def _same(cell: Cell, before: Mapping[str, Any]) -> bool:
    """Whether a run begun as `before` may go on as `cell`; options that are newer had their default."""
    try:
        began = type(cell).model_validate(before)
    except ValidationError:
        return False
    return _comparable(began) == _comparable(cell)


def _comparable(cell: Cell) -> dict[str, Any]:
    kept = {name: value for name, value in cell.model_dump(mode="json").items() if name not in _EXTENDABLE}
    return {**kept, "curriculum": {**kept["curriculum"], "episodes": None}}


def _begin_session(directory: Path, method: str) -> int:
    path = directory / SESSIONS_FILE
    session = len(path.read_text(encoding="utf-8").splitlines()) if path.exists() else 0
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"session": session, "method": method, **provenance()}) + "\n")
    return session


def _progress() -> Progress:
    fixed = Column(no_wrap=True)
    return Progress(
        BarColumn(20, table_column=fixed),
        TextColumn("{task.completed:.0f}/{task.total}", table_column=fixed),
        TimeElapsedColumn(table_column=fixed),
        TextColumn("{task.description}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")),
        console=Console(stderr=True),
        expand=True,
        disable=not sys.stderr.isatty(),
    )


def main() -> None:
    """Parse the command line, train, print the summary."""
    arguments = _arguments()
    overrides = [f"task={arguments.task}"] if arguments.task else []
    overrides += [f"seed={arguments.seed}"]
    if arguments.episodes is not None:
        overrides.append(f"curriculum.episodes={arguments.episodes}")
    try:
        cell = configure(
            arguments.cell or arguments.task or "reach",
            arguments.method,
            [*overrides, *arguments.overrides],
            arguments.out,
        )
        summary = train(cell, arguments.method, arguments.out, arguments.log)
    except (ConfigError, Stalled) as error:
        sys.exit(f"bench.run: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on from here")
    draw_runs([arguments.out], arguments.out / "curve.png")
    print(json.dumps(summary) if arguments.json else line(summary))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.run", description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--method", default="gc_pmpc_plus", choices=tuple(METHODS), metavar="METHOD", help=_methods()
    )
    parser.add_argument(
        "--task", help="reach, egg, egg_rotate or block; the cell of that name if none is given"
    )
    parser.add_argument("--cell", help="a cell of deploy/cells, or a YAML file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, help="training episodes; default: the cell's")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    parser.add_argument("--log", action="store_true", help="keep the bus log of every service")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    return parser.parse_args()


def _methods() -> str:
    return "; ".join(f"{name}: {method.about}" for name, method in METHODS.items())


if __name__ == "__main__":
    main()

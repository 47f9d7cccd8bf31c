"""Many runs from one YAML, on this machine or a cluster; each goes on where it was, and failures stay alone.

    python -m bench.sweep sweep.yaml --jobs 2
    python -m bench.sweep sweep.yaml --cluster slurm --slurm partition=cpu --slurm timeout_min=240

The file names a folder and groups of runs; every combination of a group is one run:

    out: runs/sweep
    groups:
      - {tasks: [reach, egg], methods: [gc_pmpc, pets], seeds: [0, 1, 2], episodes: 100, final_goals: 100}
      - {tasks: [reach], methods: [gc_pmpc], seeds: [0], name: wide, set: ["model.hidden=[1024, 1024]"]}

A run's results are in OUT/TASK/NAME/SEED, NAME being its group's or its method's; the rows of all finished
runs in OUT/results.jsonl. Runs have one thread each. SIGINT ends this machine's runs; start again to go on.
`--only reach/pets/1` makes a single run; after training it is evaluated on `final_goals` held-out goals.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from bench.evaluate import evaluate_end
from bench.methods import configure
from bench.result_rows import kept_evaluation, results_of, trained_episodes
from bench.run import SUMMARY_FILE, train
from bench.summary import line, summarise
from common.config import ConfigError, Frozen, load
from deploy.cell import Cell
from deploy.curriculum_files import ROWS_FILE, read_rows
from deploy.scores import Row

RESULTS_FILE = "results.jsonl"
OUTPUT_FILE = "output.txt"  # of each run: what it printed, and why it failed
FAILED = "FAILED"
LOOK_EVERY_S = 60.0  # to say how far the runs on this machine are


class Group(Frozen):
    """Runs that differ in task, method and seed only."""

    tasks: tuple[str, ...] = Field(min_length=1, description="each a cell's name")
    methods: tuple[str, ...] = Field(default=("gc_pmpc_plus",), min_length=1)
    seeds: tuple[int, ...] = Field(default=(0,), min_length=1)
    episodes: int | None = Field(default=None, ge=0, description="of training; default: the cell's")
    final_goals: int = Field(default=0, ge=0, description="held-out, of an evaluation after training")
    name: str = Field(default="", pattern=r"^[\w.-]*$", description="of its folder; default: the method")
    set: tuple[str, ...] = Field(default=(), description="changes of the cell, as a.b=c")


class Sweep(Frozen):
    """What the file holds."""

    out: Path
    groups: tuple[Group, ...] = Field(min_length=1)


@dataclass(frozen=True)
class Run:
    """One run; its directory tells runs apart."""

    task: str
    method: str
    seed: int
    overrides: tuple[str, ...]
    directory: Path
    final_goals: int = 0

    @property
    def name(self) -> str:
        """Such as reach/gc_pmpc/0."""
        return "/".join(self.directory.parts[-3:])

    def cell(self) -> Cell:
        """The configuration. Raises ConfigError."""
        return configure(self.task, self.method, (f"seed={self.seed}", *self.overrides), self.directory)


def runs_of(sweep: Sweep) -> list[Run]:
    """Every run of the file, in its order. Raises ConfigError for a bad one, and for two in one folder."""
    found: list[Run] = []
    for group in sweep.groups:
        length = () if group.episodes is None else (f"curriculum.episodes={group.episodes}",)
        for task, method, seed in product(group.tasks, group.methods, group.seeds):
            directory = sweep.out / task / (group.name or method) / str(seed)
            overrides = (*length, *group.set)
            found.append(Run(task, method, seed, overrides, directory, group.final_goals))
    for run in found:
        run.cell()
    double = [run.name for i, run in enumerate(found) if run.directory in {r.directory for r in found[:i]}]
    if double:
        raise ConfigError([f"{double[0]}: two runs would share this folder; give one group a `name`"])
    return found


def chosen(runs: Sequence[Run], names: Sequence[str]) -> list[Run]:
    """The runs that `names` name, such as reach/td7/0, or all of reach/td7 or reach. Raises ConfigError."""
    unknown = [name for name in names if not any(_is_named(run, name) for run in runs)]
    if unknown:
        raise ConfigError([f"--only {unknown[0]}: no such run; --dry-run lists them"])
    return [run for run in runs if any(_is_named(run, name) for name in names)]


def _is_named(run: Run, name: str) -> bool:
    return f"{run.name}/".startswith(f"{name.rstrip('/')}/")


def trained(run: Run) -> bool:
    """Whether the run has its summary, of at least as many episodes as asked for."""
    try:
        summary = json.loads((run.directory / SUMMARY_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return summary["training_episodes"] >= run.cell().curriculum.episodes


def finished(run: Run) -> bool:
    """Whether the run is trained and, if that was asked for, evaluated at its end."""
    return trained(run) and len(_evaluation(run)) >= run.final_goals


def _evaluation(run: Run) -> list[Row]:
    return kept_evaluation(run.directory, trained_episodes(read_rows(run.directory)))


def execute(run: Run) -> str:
    """Train, or go on training, and evaluate, in this process with one thread; returns what it came to."""
    import torch

    torch.set_num_threads(1)
    run.directory.mkdir(parents=True, exist_ok=True)
    with (run.directory / OUTPUT_FILE).open("a", encoding="utf-8") as out, contextlib.redirect_stderr(out):
        try:
            if not trained(run):
                train(run.cell(), run.method, run.directory)
            if len(_evaluation(run)) < run.final_goals:
                evaluate_end(run.directory, run.final_goals)
        except BaseException:
            traceback.print_exc(file=out)
            raise
    return line(summarise(run.directory))


def state(run: Run) -> str:
    """How far a run is, such as `reach/td7/0 12/100`, the number being that of training episodes."""
    file = run.directory / ROWS_FILE
    done = file.read_bytes().count(b'"mode": "plan"') if file.exists() else 0
    return f"{run.name} {done}/{run.cell().curriculum.episodes}"


def on_this_machine(runs: Sequence[Run], jobs: int) -> Iterator[tuple[Run, str]]:
    """Execute at most `jobs` runs at once, each in a fresh process; yields what became of each."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    threads = ThreadPoolExecutor(jobs)
    try:
        futures = {threads.submit(_in_a_process, run): run for run in runs}
        pending = set(futures)
        while pending:
            done, pending = wait(pending, LOOK_EVERY_S, FIRST_COMPLETED)
            if not done:
                underway = ", ".join(state(run) for each, run in futures.items() if each.running())
                print(f"{len(pending)} to do; {underway}", file=sys.stderr)
            for future in done:
                yield futures[future], _outcome(future)
    finally:
        threads.shutdown(cancel_futures=True)


def _in_a_process(run: Run) -> str:
    """Execute a run in a pool of its own: whatever kills the process, the other runs go on."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(execute, run).result()


def on_a_cluster(
    runs: Sequence[Run], cluster: str, folder: Path, parameters: Mapping[str, Any]
) -> Iterator[tuple[Run, str]]:
    """Submit every run as a job; yields what became of each. Raises ConfigError without submitit."""
    try:
        import submitit
    except ImportError:
        raise ConfigError(["--cluster: submitit is missing; pip install -e '.[cluster]'"]) from None
    executor = submitit.AutoExecutor(folder=folder / "%j", cluster=cluster)
    executor.update_parameters(cpus_per_task=1, **parameters)
    jobs = [executor.submit(execute, run) for run in runs]
    for run, job in zip(runs, jobs, strict=True):
        yield run, _outcome(job)


def _outcome(future: Any) -> str:
    """What a run returned, or why it failed, as one line."""
    try:
        return future.result()
    except Exception as error:  # whatever it was, the other runs go on
        lines = str(error).strip().splitlines()
        return f"{FAILED}: {type(error).__name__}: {lines[-1] if lines else ''}"


def gather(sweep: Sweep, runs: Sequence[Run]) -> int:
    """Write the rows of all finished runs into one file; returns how many runs that are."""
    done = [run for run in runs if finished(run)]
    text = "".join(json.dumps(row) + "\n" for run in done for row in results_of(run.directory))
    sweep.out.mkdir(parents=True, exist_ok=True)
    (sweep.out / RESULTS_FILE).write_text(text, encoding="utf-8")
    return len(done)


def main() -> None:
    """Parse the command line and sweep."""
    arguments = _arguments()
    try:
        sweep = load(Sweep, arguments.file)
        runs = runs_of(sweep)
        picked = chosen(runs, arguments.only) if arguments.only else runs
        left = [run for run in picked if not finished(run)]
        print(f"{len(picked)} runs, {len(left)} to do", file=sys.stderr)
        failed: list[str] = []
        for run, outcome in _start(left, sweep, arguments):
            failed += [run.name] if outcome.startswith(FAILED) else []
            print(f"{run.name}: {outcome}", file=sys.stderr)
    except ConfigError as error:
        sys.exit(f"bench.sweep: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on from here")
    done = gather(sweep, runs)
    found = {"runs": len(runs), "finished": done, "failed": failed, "results": str(sweep.out / RESULTS_FILE)}
    print(json.dumps(found) if arguments.json else _line(found))
    sys.exit(1 if failed else 0)


def _line(found: Mapping[str, Any]) -> str:
    said = f"{found['finished']} of {found['runs']} runs are finished: {found['results']}"
    failed = f"\nfailed (see {OUTPUT_FILE} in their folders): {', '.join(found['failed'])}"
    return said + (failed if found["failed"] else "")


def _start(runs: Sequence[Run], sweep: Sweep, arguments: argparse.Namespace) -> Iterator[tuple[Run, str]]:
    if arguments.dry_run:
        return ((run, "to do") for run in runs)
    if arguments.cluster:
        parameters = {f"slurm_{name}": value for name, value in map(_parameter, arguments.slurm)}
        return on_a_cluster(runs, arguments.cluster, sweep.out / "jobs", parameters)
    return on_this_machine(runs, arguments.jobs)


def _parameter(text: str) -> tuple[str, Any]:
    name, _, value = text.partition("=")
    return name, yaml.safe_load(value)


def _arguments() -> argparse.Namespace:
    about = (__doc__ or "").split("\n\n", maxsplit=1)[0]
    parser = argparse.ArgumentParser(prog="python -m bench.sweep", description=about)
    parser.add_argument("file", type=Path, metavar="FILE", help="the sweep, a YAML file")
    parser.add_argument("--jobs", type=int, default=1, help="runs at once on this machine")
    parser.add_argument(
        "--cluster", choices=("slurm", "local"), help="submit each run; local: as SLURM would, but here"
    )
    parser.add_argument("--slurm", action="append", default=[], metavar="a=b", help="partition=cpu and such")
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="RUN",
        help="one, as reach/td7/0, or reach/td7, or reach",
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be run")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args()


if __name__ == "__main__":
    main()

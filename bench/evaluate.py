"""How well a trained model reaches goals that it was not trained on: lock-step, planner and plant only.

    python -m bench.evaluate --run DIR --goals 100 --seed 1000000 --json

Without --set, and from the first held-out goal on, the run keeps how the goals went (DIR/evaluations), and
`python -m bench.report --collect DIR` makes the run's final row of the evaluation with most goals.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from bench.agents import AgentCell, AgentModel, load_agent
from bench.lockstep_run import WITHOUT_LEARNER, LockstepRun, Stalled, assemble
from bench.methods import cell_of
from bench.provenance import commit, provenance
from bench.result_rows import is_of_bench, keep_evaluation
from bench.summary import result_line, result_of, share
from common.config import ConfigError, read_yaml, with_overrides
from common.model.snapshot import Snapshot, SnapshotRefused
from deploy.cell import Cell
from deploy.curriculum_config import FIRST_EVALUATION_SEED
from deploy.curriculum_files import read_rows
from deploy.scores import Row

CONFIG_FILES = ("config.yaml", "config/cell.yaml")  # of bench.run, and of a live run
SNAPSHOT_FILE = Path("learner") / "snapshot.safetensors"

# No warm-up and no training: what is left of a curriculum is one evaluation.
_ONLY_EVALUATE = ("warmup_steps=0", "curriculum.episodes=0")


def configuration(run: Path, goals: int, seed: int, overrides: Iterable[str]) -> Cell:
    """Return the run's own configuration, turned into one evaluation. Raises ConfigError."""
    path = next((run / name for name in CONFIG_FILES if (run / name).exists()), run / CONFIG_FILES[0])
    own = (*_ONLY_EVALUATE, f"curriculum.evaluate_goals={goals}", f"curriculum.evaluation_seed={seed}")
    return cell_of(with_overrides(read_yaml(path), (*overrides, *own)), path.name, run)


def load_model(cell: Cell, run: Path) -> Snapshot | AgentModel:
    """Read what the run has learned last. Raises ConfigError when there is nothing."""
    return load_agent(cell, run) if isinstance(cell, AgentCell) else load_snapshot(run)


def load_snapshot(run: Path) -> Snapshot:
    """Read the run's newest model. Raises ConfigError when there is none."""
    path = run / SNAPSHOT_FILE
    try:
        return Snapshot.from_bytes(path.read_bytes())
    except OSError as error:
        raise ConfigError([f"{path}: no trained model ({error.strerror})"]) from None
    except SnapshotRefused as error:
        raise ConfigError([f"{path}: {error}"]) from None


def evaluate(
    cell: Cell,
    model: Snapshot | AgentModel,
    watch: Callable[[LockstepRun], None] = lambda _: None,
    log_dir: Path | None = None,
) -> list[Row]:
    """Run the cell's held-out goals with this model; one row a goal. Raises Stalled.

    `log_dir` receives the bus log of each service.
    """
    with tempfile.TemporaryDirectory() as directory:
        alone = cell.model_copy(update={"run_dir": Path(directory)})
        if isinstance(model, AgentModel):
            run = assemble(alone, agent=model, log_dir=log_dir)
        else:
            run = assemble(alone, WITHOUT_LEARNER, snapshot=model, log_dir=log_dir)
        run.drive(lambda: watch(run))
        return read_rows(Path(directory))


def evaluate_end(run: Path, goals: int) -> None:
    """Evaluate what a run learned last on the first held-out goals, and keep how they went beside it."""
    cell = configuration(run, goals, FIRST_EVALUATION_SEED, ())
    keep_evaluation(run, evaluate(cell, load_model(cell, run)), commit())


def result(cell: Cell, model: Snapshot | AgentModel, rows: list[Row], wall_s: float) -> dict[str, Any]:
    """Put the result together with everything that it depends on."""
    method = {"agent": cell.agent} if isinstance(cell, AgentCell) else {}
    return {
        "task": cell.task,
        "training_seed": cell.seed,
        "snapshot_id": model.id,
        "episodes_seen": model.episodes if isinstance(model, AgentModel) else model.meta.episodes,
        "goal_seeds": [rows[0]["episode_seed"], rows[-1]["episode_seed"]],
        **result_of(rows),
        "late_share": share(rows, "late"),
        "held_share": share(rows, "held"),
        "dropped": sum(row["dropped"] for row in rows),
        "control": cell.control.model_dump(mode="json"),
        **(method or {"planner": cell.planner.model_dump(mode="json")}),
        "config_hash": cell.config_hash,
        "wall_s": round(wall_s, 1),
        **provenance(),
    }


def main() -> None:
    """Parse the command line, evaluate, print."""
    arguments = _arguments()
    begun_s = time.monotonic()
    try:
        cell = configuration(arguments.run, arguments.goals, arguments.seed, arguments.overrides)
        model = load_model(cell, arguments.run)
        with Progress(console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar:
            bar_id = bar.add_task("evaluating", total=arguments.goals)
            rows = evaluate(cell, model, lambda run: _show(bar, bar_id, run))
    except (ConfigError, Stalled) as error:
        sys.exit(f"bench.evaluate: {error}")
    found = result(cell, model, rows, time.monotonic() - begun_s)
    if arguments.rows:
        text = "".join(json.dumps(row) + "\n" for row in rows)
        arguments.rows.write_text(text, encoding="utf-8")
    if arguments.seed == FIRST_EVALUATION_SEED and not arguments.overrides and is_of_bench(arguments.run):
        keep_evaluation(arguments.run, rows, found["commit"])
    print(json.dumps(found) if arguments.json else _line(found))


def _show(bar: Progress, bar_id: Any, run: LockstepRun) -> None:
    if not bar.disable:
        bar.update(bar_id, completed=run.services["curriculum"].report().fields["episode"])


def _line(found: dict[str, Any]) -> str:
    lateness = f"late {found['late_share']:.1%}, held {found['held_share']:.1%}"
    return (
        f"{found['task']}, {found['goals']} goals: {result_line(found)}; {lateness}; {found['wall_s']:.0f} s"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench.evaluate", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--run", type=Path, required=True, metavar="DIR", help="what bench.run wrote")
    parser.add_argument("--goals", type=int, default=100)
    parser.add_argument("--seed", type=int, default=FIRST_EVALUATION_SEED, help="of the first goal")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="write one JSON line per goal")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    return parser.parse_args()


if __name__ == "__main__":
    main()

"""A few goals, several trained runs of one task: errors over the steps, and the hand in pictures.

    python -m bench.case_study --run DIR --run DIR --run DIR --goals 3 --out docs/results

OUT receives case_study_TASK.png with the errors, case_study_TASK_goal_N.png with a strip of pictures for each
run, and case_study_TASK.md, which shows them and says how each episode ended.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.evaluate import configuration, evaluate, load_model
from bench.hand_frames import HandCamera, strip
from bench.lockstep_run import Stalled
from bench.result_rows import label_of
from bench.stated import COMPARED, FURTHER
from common.built import codec_for
from common.buslog import log_files, read_log
from common.config import ConfigError
from common.messages import Step
from common.task import ManipulateTask, Task, get_task
from common.topics import STEP
from deploy.cell import Cell
from deploy.curriculum_config import FIRST_EVALUATION_SEED
from deploy.curriculum_files import read_rows
from deploy.markdown import table
from services.sim.plant import ENV_IDS

PICTURES = 6  # of an episode, the first and the last state among them
_COLOURS = 160  # of a strip; keeps its file small
_DPI = 100

_HEAD = """# Case study: {task}

Made by `python -m bench.case_study`, on goals that training never saw. Dashed: the paper's thresholds. A
curve ends where the object is lost.

![Errors over steps]({name}.png)
"""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Episode:
    """One evaluation episode: goal (G,) and states (T + 1, S)."""

    goal: Floats
    states: Floats


@dataclass(frozen=True)
class Curve:
    """One error over the steps: its name in `Task.errors`, its title, and the threshold of success."""

    key: str
    title: str
    factor: float
    threshold: float


Study = Mapping[str, Sequence[Episode]]  # what each run is called → an episode for each goal


def curves_of(task: Task) -> tuple[Curve, ...]:
    """What the paper's success looks at."""
    if not isinstance(task, ManipulateTask):
        return (Curve("mean_finger_m", "mean finger error, mm", 1e3, 2.0),)
    rotation = Curve("rotation_rad", "rotation error, rad", 1.0, task.paper_threshold_rad)
    position = Curve("position_m", "position error, mm", 1e3, 1e3 * task.paper_threshold_m)
    return (rotation, position) if task.position_counts else (rotation,)


def study_of(runs: Sequence[Path], goals: int, seed: int) -> tuple[Task, Study]:
    """Evaluate each run on the same held-out goals. Raises ConfigError or Stalled."""
    cells = {run: configuration(run, goals, seed, ()) for run in runs}
    tasks = sorted({cell.task for cell in cells.values()})
    if len(tasks) > 1 or tasks[0] not in ENV_IDS:
        raise ConfigError(
            [f"the runs must be of one task among {', '.join(ENV_IDS)}, not {', '.join(tasks)}"]
        )
    study: dict[str, list[Episode]] = {}
    for run, cell in cells.items():
        name = name_of(run)
        print(f"evaluating {run}", file=sys.stderr)
        study[name if name not in study else f"{name}, {run}"] = play(cell, run)
    return get_task(tasks[0]), study


def play(cell: Cell, run: Path) -> list[Episode]:
    """Evaluate a run as `cell` says; every state of each episode. Raises ConfigError or Stalled."""
    with tempfile.TemporaryDirectory() as directory:
        evaluate(cell, load_model(cell, run), log_dir=Path(directory))
        return list(episodes(Path(directory), cell.task))


def episodes(log_dir: Path, task: str) -> Iterator[Episode]:
    """What the plant published, episode by episode."""
    codec, steps = codec_for(task), defaultdict[int, dict[int, Step]](dict)
    for file in log_files(log_dir):
        for entry in read_log(file) if file.name.startswith("sim-") else ():
            if entry.kind == "out" and entry.key == STEP.key:
                step: Step = codec.decode(entry.key, entry.payload).message
                steps[step.episode][step.k] = step
    for _, found in sorted(steps.items()):
        states = np.stack([found[k].state for k in sorted(found)]).astype(np.float64)
        yield Episode(found[0].goal.astype(np.float64), states)


def name_of(run: Path) -> str:
    """What figures call a run."""
    label = label_of(run, read_rows(run)[-1])
    return {**COMPARED, **FURTHER}.get(label, label)


# --- drawing ----------------------------------------------------------------------------------------


def draw(task: Task, study: Study, out: Path) -> None:
    """Draw errors and strips into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    _drawerrors_of(task, study, out / f"case_study_{task.name}.png")
    camera = HandCamera(task.name)
    try:
        for goal in range(len(next(iter(study.values())))):
            _draw_strips(camera, study, goal, out / f"case_study_{task.name}_goal_{goal + 1}.png")
    finally:
        camera.close()


def _drawerrors_of(task: Task, study: Study, path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    curves, goals = curves_of(task), len(next(iter(study.values())))
    size = (4.0 * goals, 0.4 + 2.8 * len(curves))
    figure, axes = plt.subplots(
        len(curves), goals, figsize=size, squeeze=False, layout="constrained", sharey="row"
    )
    for row, curve in zip(axes, curves, strict=True):
        for goal, axis in enumerate(row):
            for name, played in study.items():
                axis.plot(errors_of(task, played[goal], curve), label=name, linewidth=1.6)
            axis.axhline(curve.threshold, color="0.4", linestyle="--", linewidth=1)
            axis.grid(alpha=0.25)
            axis.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel(curve.title, fontsize=9)
        row[0].set_ylim(bottom=0.0)
    for goal in range(goals):
        axes[0, goal].set_title(f"goal {goal + 1}", fontsize=10)
        axes[-1, goal].set_xlabel("steps", fontsize=9)
    axes[0, 0].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def errors_of(task: Task, episode: Episode, curve: Curve) -> Floats:
    """The error (T + 1,) in the curve's unit; nothing once the object has been lost."""
    errors = curve.factor * np.asarray(task.errors(episode.states, episode.goal)[curve.key], dtype=np.float64)
    lost = np.maximum.accumulate(np.asarray(task.dropped(episode.states)))
    return np.where(lost, np.nan, errors)


def _draw_strips(camera: HandCamera, study: Study, goal: int, path: Path) -> None:
    """A row of pictures for each run."""
    from PIL import Image

    rows: list[Any] = []
    for played in study.values():
        episode = played[goal]
        shown = np.linspace(0, len(episode.states) - 1, PICTURES).round().astype(int)
        rows.append(strip([camera.frame(episode.states[k], episode.goal) for k in shown]))
    Image.fromarray(np.concatenate(rows)).quantize(_COLOURS).save(path, optimize=True)


def page(task: Task, study: Study) -> str:
    """The pictures, and how each episode ended."""
    name, goals = f"case_study_{task.name}", len(next(iter(study.values())))
    parts = [_HEAD.format(task=task.name, name=name)]
    for goal in range(goals):
        heads = ("method", *(f"{curve.title}, at the end" for curve in curves_of(task)), "reached", "lost")
        ends = table(heads, (_end_row(task, method, played[goal]) for method, played in study.items()))
        order = f"From above: {', '.join(study)}; from left: first to last step."
        parts.append(f"## Goal {goal + 1}\n\n{ends}\n{order}\n\n![The hand]({name}_goal_{goal + 1}.png)\n")
    return "\n".join(parts)


def _end_row(task: Task, name: str, episode: Episode) -> tuple[str, ...]:
    end, goal = episode.states[-1], episode.goal
    errors = task.errors(end, goal)
    lost = bool(np.any(np.asarray(task.dropped(episode.states))))
    reached = bool(task.successes(end, goal)["success_paper"])
    shown = (f"{curve.factor * float(errors[curve.key]):.2f}" for curve in curves_of(task))
    return (name, *shown, "yes" if reached else "no", "yes" if lost else "no")


def main() -> None:
    """Parse the command line, evaluate, draw."""
    arguments = _arguments()
    try:
        task, study = study_of(arguments.run, arguments.goals, arguments.seed)
        draw(task, study, arguments.out)
    except (ConfigError, Stalled, OSError, RuntimeError) as error:
        sys.exit(f"bench.case_study: {error}")
    path = arguments.out / f"case_study_{task.name}.md"
    path.write_text(page(task, study), encoding="utf-8")
    print(path)


def _arguments() -> argparse.Namespace:
    about = (__doc__ or "").split("\n\n", maxsplit=1)[0]
    parser = argparse.ArgumentParser(prog="python -m bench.case_study", description=about)
    parser.add_argument("--run", type=Path, action="append", required=True, metavar="DIR", help="trained run")
    parser.add_argument("--goals", type=int, default=3)
    parser.add_argument("--seed", type=int, default=FIRST_EVALUATION_SEED, help="of the first goal")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    return parser.parse_args()


if __name__ == "__main__":
    main()

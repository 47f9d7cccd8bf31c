"""The motions with which the die was turned: joint angles and error over the steps, an episode for each face.

python -m bench.trajectories --run DIR [--out trajectories.png] [--newest]

DIR is a run of the die by `bench.run` or by a cell; the episodes are those that its learner has stored, so
evaluations, which are not learned from, are not among them. Of each face the planned episode is drawn that
ended nearest to its goal, or with --newest the last one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.tables import JOINTS, MOTORS
from common.messages import Mode
from common.task import DieTask, get_task
from deploy.curriculum_files import read_rows
from services.learner.episode import Episode, EpisodeRefused, check, from_bytes

EPISODES = Path("learner", "episodes")
FINGERS = {"th": "thumb", "ff": "index", "mf": "middle", "rf": "ring", "lf": "little finger"}
ACTIVE = 4  # joints that stand out, as many as the paper's case study shows
_COLOURS = {"mcp": "C0", "dip": "C1", "rot": "C2", "spr": "C2"}
_WIDTH_IN, _HEIGHT_IN, _DPI = 3.6, 1.6, 110

Floats = NDArray[np.float64]


class NothingToDrawError(Exception):
    """A run without such an episode; the message is one line that says what is missing."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode for people: degrees and millimetres, NaN where a state was not measured as a whole."""

    face: int
    episode: int
    angles_deg: Floats  # (T + 1, 12)
    turn_deg: Floats  # (T + 1,) that the die is turned away from the goal, the shortest way
    distance_mm: Floats  # (T + 1,) from the goal
    reached: bool  # the goal's face was uppermost in the end
    dropped: bool

    @property
    def left_deg(self) -> float:
        """The angle that was left at the last whole state, infinite without any."""
        measured = self.turn_deg[np.isfinite(self.turn_deg)]
        return float(measured[-1]) if len(measured) else float("inf")

    @property
    def failure(self) -> tuple[bool, bool, float]:
        """What decides which of two ended better, the smaller: die in the hand, face up, angle left."""
        return self.dropped, not self.reached, self.left_deg

    def most_active(self) -> list[int]:
        """The `ACTIVE` joints that moved most, by the length of their way, in the order of JOINTS."""
        way = np.nansum(np.abs(np.diff(self.angles_deg, axis=0)), axis=0)
        return sorted(np.argsort(-way, kind="stable")[:ACTIVE].tolist())


def task_of(directory: Path) -> DieTask:
    """The task of a run. Raises NothingToDrawError if it has no die, or no finished episode."""
    try:
        rows = read_rows(directory)
    except OSError as error:
        raise NothingToDrawError(f"{directory}: is no run directory ({error.strerror})") from None
    if not rows:
        raise NothingToDrawError(f"{directory}: no episode has been finished")
    task = get_task(rows[0]["task"])
    if not isinstance(task, DieTask):
        raise NothingToDrawError(f"{directory}: a run of {task.name}; only the die's have these joints")
    return task


def planned_episodes(directory: Path, task: DieTask) -> Iterator[Episode]:
    """Each planned episode that the learner has stored, as they arrived; unusable files are passed over."""
    seen: set[int] = set()
    for path in sorted((directory / EPISODES).glob("*.safetensors")):
        try:
            episode = from_bytes(path.read_bytes())
            check(episode, task.state_dim, task.action_dim)
        except EpisodeRefused:
            continue
        if episode.mode == Mode.PLAN and episode.episode not in seen:
            seen.add(episode.episode)
            yield episode


def trajectory(episode: Episode, task: DieTask) -> Trajectory:
    """What an episode of the die looked like."""
    states, goal = episode.states.astype(np.float64), episode.goal.astype(np.float64)
    unseen = ~episode.valid
    errors = task.errors(states, goal)
    successes = task.successes(states[-1], goal)
    return Trajectory(
        face=task.face_of(goal),
        episode=episode.episode,
        angles_deg=np.where(unseen[:, None], np.nan, np.degrees(states[:, :MOTORS])),
        turn_deg=np.where(unseen, np.nan, np.degrees(errors["rotation_rad"])),
        distance_mm=np.where(unseen, np.nan, 1e3 * errors["position_m"]),
        reached=bool(successes["success_paper"] and episode.valid[-1]),
        dropped=bool(np.any(task.dropped(states[episode.valid]))),
    )


def chosen(found: Sequence[Trajectory], newest: bool = False) -> list[Trajectory]:
    """One for each face, by its number: that which ended nearest to its goal, or the last one."""
    best: dict[int, Trajectory] = {}
    for each in found:
        other = best.get(each.face)
        if other is None or newest or each.failure < other.failure:
            best[each.face] = each
    return [best[face] for face in sorted(best)]


def draw(columns: Sequence[Trajectory], out: Path) -> None:
    """Save a column for each trajectory: its error above, then the joints of a finger in each row."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    shape = (1 + len(FINGERS), len(columns))
    size = (1.4 + _WIDTH_IN * shape[1], _HEIGHT_IN * shape[0])
    figure, axes = plt.subplots(
        *shape, sharex=True, sharey="row", squeeze=False, figsize=size, layout="constrained"
    )
    for column, each in zip(axes.T, columns, strict=True):
        _draw_errors(column[0], each)
        for axis, finger in zip(column[1:], FINGERS, strict=True):
            _draw_finger(axis, each, finger)
        column[-1].xaxis.get_major_locator().set_params(integer=True)
    for axis, name in zip(
        axes[:, 0], ("die from its goal", *(f"{finger}, °" for finger in FINGERS.values())), strict=True
    ):
        axis.set_ylabel(name, fontsize=8)
    _furnish(axes)
    figure.supxlabel(f"step (thick: the {ACTIVE} joints that moved most in the episode)", fontsize=9)
    figure.savefig(out, dpi=_DPI)
    plt.close(figure)


def _furnish(axes: Any) -> None:
    for axis in axes.flat:
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[:, -1]:
        legend = axis.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        for line in legend.get_lines():
            line.set_linewidth(1.2)


def _draw_errors(axis: Any, each: Trajectory) -> None:
    axis.set_title(f"face {each.face} (episode {each.episode}: {_verdict(each)})", fontsize=9)
    steps = np.arange(len(each.turn_deg))
    axis.plot(steps, each.turn_deg, color="k", linewidth=1.6, label="turn, °")
    axis.plot(steps, each.distance_mm, color="0.55", linewidth=1.0, label="distance, mm")


def _verdict(each: Trajectory) -> str:
    return "dropped" if each.dropped else "face up" if each.reached else "face not up"


def _draw_finger(axis: Any, each: Trajectory, finger: str) -> None:
    """The joints of a finger; those that moved most in the episode are drawn thick."""
    active = each.most_active()
    for i, joint in enumerate(JOINTS):
        own, _, kind = joint.name.partition("_")
        if own == finger:
            angles = each.angles_deg[:, i]
            width = 2.2 if i in active else 0.8
            axis.plot(angles, color=_COLOURS[kind], linewidth=width, label=joint.paper_name)


def main() -> None:
    """Parse the command line, choose and draw."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.trajectories", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--run", type=Path, required=True, metavar="DIR", help="a run of the die")
    parser.add_argument("--out", type=Path, default=Path("trajectories.png"))
    parser.add_argument("--newest", action="store_true", help="the last episode of each face, not the best")
    arguments = parser.parse_args()
    try:
        task = task_of(arguments.run)
        found = [trajectory(episode, task) for episode in planned_episodes(arguments.run, task)]
        if not found:
            raise NothingToDrawError(f"{arguments.run}: no planned episode is stored in {EPISODES}")
        columns = chosen(found, arguments.newest)
        draw(columns, arguments.out)
    except (NothingToDrawError, OSError) as error:
        sys.exit(f"bench.trajectories: {error}")
    for each in columns:
        print(_line(each))
    print(arguments.out)


def _line(each: Trajectory) -> str:
    joints = ", ".join(JOINTS[i].paper_name for i in each.most_active())
    ended = f"{_verdict(each)}, {each.left_deg:.0f}° left"
    return f"face {each.face}: episode {each.episode}, {ended}; most active: {joints}"


if __name__ == "__main__":
    main()

"""THE process table: what runs in a cell, in which order it starts and stops, and who may restart it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from common.hand_messages import PoseSource

PlantKind = Literal["sim", "twin", "hand"]


@dataclass(frozen=True)
class Process:
    """One row: a process is `python -m MODULE --config <run_dir>/config/<name>.yaml`."""

    name: str
    module: str
    kind: Literal["bus", "plant", "method", "operator"]
    stop_wave: int  # all of one wave are stopped together, wave 0 first
    plants: tuple[PlantKind, ...] = ()  # runs in cells with one of these plants; empty: in all
    pose_source: PoseSource | None = None  # and only if this one tells where the die is; None: whoever does
    sections: tuple[str, ...] = ()  # of the cell, beside those that every process has
    needs: tuple[str, ...] = (
        "router",
    )  # cannot do its work without them; begun before it, but not waited for
    heartbeat: bool = True  # publishes health; a process without it shows by what it makes possible
    start_deadline_s: float = 60.0  # from its start to its first heartbeat, on a busy laptop
    warm_up_s: int = 10  # a death before this counts as a failed start; the pauses between those grow
    autorestart: Literal["always", "on_error"] = "always"  # on_error: exit code 0 means finished
    watchdog_restarts: bool = True  # never a process that moves a real hand: people arm those
    required: bool = True  # a cell is complete without the others


# In order of start.
PROCESSES: tuple[Process, ...] = (
    Process(
        "router",
        "deploy.router",
        "bus",
        stop_wave=3,
        needs=(),
        heartbeat=False,
        start_deadline_s=30.0,
        warm_up_s=5,
    ),
    Process("sim", "services.sim", "plant", stop_wave=1, plants=("sim",), sections=("twin", "glove")),
    Process(
        "emulator",
        "services.sim.emulator",
        "plant",
        stop_wave=2,  # after what drives it, as a hand would be there still
        plants=("twin",),
        sections=("can", "hand", "emulator", "twin", "pose_source"),
    ),
    Process(
        "hand_io",
        "services.hand_io",
        "plant",
        stop_wave=1,
        plants=("twin", "hand"),
        sections=("can", "hand", "hand_io", "pose_source", "glove"),
        watchdog_restarts=False,
    ),
    Process(
        "camera",
        "services.sim.twin_camera",
        "plant",
        stop_wave=2,
        plants=("twin",),
        pose_source=PoseSource.PERCEPTION,
        sections=("hand", "camera", "twin"),
        needs=("router", "emulator"),
    ),
    Process(
        "perception",
        "services.perception",
        "plant",
        stop_wave=1,
        plants=("twin", "hand"),
        pose_source=PoseSource.PERCEPTION,
        sections=("perception", "camera"),
        needs=("router", "camera"),
    ),
    Process("planner", "services.planner", "method", stop_wave=0, sections=("planner",)),
    Process("learner", "services.learner", "method", stop_wave=0, sections=("model", "learner")),
    Process(
        "viewer",
        "deploy.viewer",
        "operator",
        stop_wave=2,
        sections=("viewer", "plant", "pose_source"),
        required=False,
    ),
    Process(
        "watchdog",
        "deploy.watchdog",
        "operator",
        stop_wave=0,
        sections=("watchdog",),
        watchdog_restarts=False,
        required=False,
    ),
    Process(
        "curriculum",
        "deploy.curriculum",
        "operator",
        stop_wave=0,
        sections=("curriculum",),
        needs=(
            "router",
            "sim",
            "emulator",
            "hand_io",
            "perception",
            "planner",
            "learner",
        ),  # those that the cell has
        warm_up_s=0,  # a run that is taken up again may be finished at once
        autorestart="on_error",
    ),
)

NAMES: tuple[str, ...] = tuple(process.name for process in PROCESSES)
WATCHDOG = "watchdog"


def processes_of(plant: str, pose_source: PoseSource = PoseSource.TWIN) -> tuple[Process, ...]:
    """The rows of a cell with this plant and this teller of the die's pose, in order of start."""
    return tuple(
        process
        for process in PROCESSES
        if (not process.plants or plant in process.plants) and process.pose_source in (None, pose_source)
    )


def process_of(instance: str) -> Process:
    """Find the row of an instance: `planner`, or `watchdog_<machine>`. Raises KeyError for an unknown one."""
    wanted = WATCHDOG if instance.startswith(f"{WATCHDOG}_") else instance
    for process in PROCESSES:
        if process.name == wanted:
            return process
    raise KeyError(instance)

"""The curves of a task's dashboard: path, legend and colours, in the order of the values drawn there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from common.messages import Fallback, Mode
from common.task import DieTask, ManipulateTask, ReachTask, Task
from deploy.viewer.drawing import Drawing, When, scalars

Rgb = tuple[int, int, int]

# ff, mf, rf, lf, th: the hues of the goal markers in the scene, light enough for a dark background.
FINGER_RGB: tuple[Rgb, ...] = (
    (255, 90, 90),
    (90, 220, 110),
    (110, 160, 255),
    (245, 215, 80),
    (240, 120, 245),
)
WHITE: Rgb = (240, 240, 240)
GREY: Rgb = (140, 140, 140)
LIGHT_BLUE: Rgb = (120, 190, 255)
BAND: Rgb = (70, 105, 145)
ORANGE: Rgb = (255, 165, 70)
RED: Rgb = (255, 90, 90)

EPISODE_RGB: Mapping[str, Rgb] = MappingProxyType(
    {Mode.RANDOM: GREY, Mode.PLAN: LIGHT_BLUE, Mode.EVALUATE: FINGER_RGB[1], Mode.GLOVE: FINGER_RGB[4]}
)
TO_GOAL = "world/to_goal"  # lines from the fingertips to their goals
LANES: Mapping[str, Mapping[str, Rgb]] = MappingProxyType(
    {
        "state/mode": {
            Mode.RANDOM: (120, 120, 130),
            Mode.PLAN: (60, 120, 200),
            Mode.EVALUATE: (60, 160, 95),
            Mode.GLOVE: (150, 95, 180),
        },
        "state/action": {
            Mode.RANDOM: (120, 120, 130),
            Mode.PLAN: (60, 120, 200),
            Mode.GLOVE: (150, 95, 180),
            Fallback.START: (120, 120, 130),
            Fallback.HOLD: (225, 150, 50),
            Fallback.RELAX: (210, 70, 70),
        },
    }
)

# One joint of each finger, in the order of FINGER_RGB, of the one hand and the other.
SHOWN_JOINTS = (
    *("FFJ2", "MFJ2", "RFJ2", "LFJ2", "THJ3"),
    *("ff_mcp", "mf_mcp", "rf_mcp", "lf_mcp", "th_rot"),
)
MM = 1000.0
BAND_DEVIATIONS = 2.0


@dataclass(frozen=True)
class Curves:
    """The curves of one entity."""

    path: str
    names: tuple[str, ...]
    colours: tuple[Rgb, ...] = ()  # none: the viewer chooses
    width: float = 1.5
    marks: Literal["lines", "points", "both"] = "lines"


@dataclass(frozen=True)
class Arrows:
    """The arrow of one entity, which moves with a body of the scene."""

    path: str
    body: str
    colour: Rgb


@dataclass(frozen=True)
class Watched:
    """A state dimension whose prediction is compared with what came; shown as `scale` times its value."""

    name: str
    path: str
    index: int
    scale: float


def shown_joints(task: Task) -> tuple[str, ...]:
    """The joints of the task's hand whose actions have a view of their own."""
    return tuple(name for name in SHOWN_JOINTS if name in task.actuator_names)


def watched_of(task: Task) -> tuple[Watched, ...]:
    """Three dimensions that tell whether the model understands the task."""
    if isinstance(task, ReachTask):
        start = task.group("tips").start
        tips = [(finger, start + 3 * i + 2) for i, finger in enumerate(task.finger_names)]
        chosen = [tips[0], tips[1], tips[-1]]
        return tuple(Watched(f"{f} tip height, mm", f"prediction/{f}_z_mm", i, MM) for f, i in chosen)
    position = task.group("object_position")
    # In the frame of a palm that looks up, x is height.
    height = position.start if isinstance(task, DieTask) else position.stop - 1
    rotation = task.group("object_rotation").start
    return (
        Watched("object height, mm", "prediction/object_z_mm", height, MM),
        Watched("object rotation, w", "prediction/object_qw", rotation, 1.0),
        Watched("object rotation, x", "prediction/object_qx", rotation + 1, 1.0),
    )


def curves_of(task: Task) -> tuple[Curves, ...]:
    """All entities of the task that hold several curves, or one whose name is not its path's."""
    joints = shown_joints(task)
    return (
        *_goal_curves(task),
        Curves("actions/executed", joints, FINGER_RGB),
        Curves("actions/planned", tuple(f"{j} planned" for j in joints), FINGER_RGB, 1.5, "points"),
        Curves("actions/all", task.actuator_names),
        Curves("timing/plan_ms", ("solve", "budget"), (LIGHT_BLUE, GREY)),
        Curves("timing/age_ms", ("age of the plan in use",), (ORANGE,)),
        Curves("timing/lost", ("late", "held", "relaxed"), (FINGER_RGB[3], ORANGE, RED), 2.5),
        *(
            Curves(f"episodes/{what}/{mode}", (mode,), (colour,), 1.5, "both")
            for what in ("return", "final_error")
            for mode, colour in EPISODE_RGB.items()
        ),
        Curves("prediction/z", (*(group.name for group in task.groups), "honest"), ()),
        *(curves for watched in watched_of(task) for curves in _prediction_curves(watched)),
    )


def _prediction_curves(watched: Watched) -> tuple[Curves, Curves]:
    names = ("predicted", "+2 std", "-2 std")
    return (
        Curves(f"{watched.path}/predicted", names, (LIGHT_BLUE, BAND, BAND), 1.2),
        Curves(f"{watched.path}/actual", ("actual",), (WHITE,), 1.8),
    )


def _goal_curves(task: Task) -> tuple[Curves, ...]:
    if isinstance(task, ReachTask):
        names = (*task.finger_names, "mean", f"success {task.paper_threshold_m * MM:g}")
        return (Curves("goal/error_mm", names, (*FINGER_RGB, WHITE, GREY)),)
    assert isinstance(task, ManipulateTask)
    within = (f"success {task.paper_threshold_m * MM:g}",) if task.position_counts else ()
    return (
        Curves("goal/error_mm", ("object position", *within), (WHITE, GREY)[: 1 + len(within)]),
        Curves("goal/error_rad", ("object rotation", f"success {task.paper_threshold_rad:g}"), (WHITE, GREY)),
    )


def goal_errors(
    task: Task, state: NDArray[np.float32], goal: NDArray[np.float32], when: When
) -> list[Drawing]:
    """Distances of state (S,) to goal (G,) in mm and rad beside the paper's thresholds."""
    errors = {name: float(value) for name, value in task.errors(state, goal).items()}
    if isinstance(task, ReachTask):
        fingers = task.finger_errors_m(state, goal)
        values = [*fingers, errors["mean_finger_m"], task.paper_threshold_m]
        return [scalars("goal/error_mm", when, np.multiply(values, MM))]
    assert isinstance(task, ManipulateTask)
    position = [errors["position_m"], *([task.paper_threshold_m] if task.position_counts else [])]
    return [
        scalars("goal/error_mm", when, np.multiply(position, MM)),
        scalars("goal/error_rad", when, [errors["rotation_rad"], task.paper_threshold_rad]),
    ]


def headline(task: Task, state: NDArray[np.float32], goal: NDArray[np.float32]) -> tuple[float, str]:
    """The one error that the task is about, and its unit: mm of the mean finger, or rad of the object."""
    errors = task.errors(state, goal)
    if isinstance(task, ReachTask):
        return float(errors["mean_finger_m"]) * MM, "mm"
    return float(errors["rotation_rad"]), "rad"

"""The dashboard's layout: hand and goal at the left, actions and predictions, then timing and learning."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb

from common.task import DieTask, ReachTask, Task
from deploy.viewer.camera_page import camera_page
from deploy.viewer.curves import watched_of
from deploy.viewer.hand_page import hand_page
from deploy.viewer.others import holdout_path
from deploy.viewer.views import recent, whole

BACKGROUND = (22, 25, 32)
# Eye and what it looks at: the direction of the environments' own camera, from nearer; for the DexHand from
# above its wrist and thumb.
EYE_M, LOOK_AT_M = (0.86, 0.67, 0.29), (1.0, 0.89, 0.17)
DEXHAND_EYE_M, DEXHAND_LOOK_AT_M = (-0.06, -0.17, 0.42), (0.13, 0.0, 0.245)


def dashboard(task: Task, driven: bool, watched: bool = False) -> rrb.Blueprint:
    """One page for everything that the viewer draws for `task`, and for the DexHand one about the hand.

    A hand that is `watched` by a camera has a page about that, too.

    A hand that is `driven` over a bus tells of itself between the steps too, so its axis is time.
    """
    top: Any = _learning_page(task)
    if isinstance(task, DieTask):
        camera = [camera_page(_scene(task))] if watched else []
        top = rrb.Tabs(hand_page(_scene(task), driven), *camera, top, active_tab=0)
    bottom = rrb.Horizontal(_states(), _log(), column_shares=[5, 8])
    return rrb.Blueprint(
        rrb.Vertical(top, bottom, row_shares=[5, 1]),
        rrb.TimePanel(state="collapsed", timeline="time" if driven else "step", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def _learning_page(task: Task) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.Vertical(_scene(task), *_goal(task), row_shares=[3, *[1.4] * len(_goal(task))]),
        rrb.Vertical(_actions(), *_predictions(task)),
        rrb.Vertical(_timing(), _losses(), _learning(task), _episodes()),
        column_shares=[5, 4, 4],
        name="Model and plan",
    )


def _scene(task: Task) -> rrb.Spatial3DView:
    dexhand = isinstance(task, DieTask)
    position, target = (DEXHAND_EYE_M, DEXHAND_LOOK_AT_M) if dexhand else (EYE_M, LOOK_AT_M)
    eye = rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 0.0, 1.0))
    return rrb.Spatial3DView(
        origin="world", name="Hand and goal", eye_controls=eye, line_grid=False, background=BACKGROUND
    )


def _goal(task: Task) -> list[rrb.TimeSeriesView]:
    if isinstance(task, ReachTask):
        return [recent("Distance of each fingertip to its goal, mm", "goal/error_mm")]
    return [
        recent("Angle to the goal, rad", "goal/error_rad"),
        recent("Distance to the goal, mm", "goal/error_mm"),
    ]


def _actions() -> rrb.Tabs:
    shown = recent("Action: executed (lines), planned (dots)", "actions/executed", "actions/planned")
    return rrb.Tabs(shown, recent("All actions", "actions/all"), name="Actions")


def _predictions(task: Task) -> list[Any]:
    views: list[Any] = [
        recent(f"Predicted: {watched.name}, ±2 std", f"{watched.path}/**", legend=number == 0)
        for number, watched in enumerate(watched_of(task))
    ]
    error = recent("Prediction error / predicted std", "prediction/z")
    return [*views[:-1], rrb.Tabs(views[-1], error)]


def _timing() -> rrb.Tabs:
    plan = recent("Plan: solve time, budget, age, ms", "timing/plan_ms", "timing/age_ms")
    loops = recent("Main loops, p99, ms", "health/loop_p99_ms/**")
    memory = recent("Memory, MB", "health/rss_mb/**")
    return rrb.Tabs(plan, loops, memory)


def _losses() -> rrb.Tabs:
    lost = recent("Late, held and relaxed steps so far", "timing/lost")
    services = recent("Refused, dropped, overrun per service", "health/lost/**")
    return rrb.Tabs(lost, services, recent("Counters of the services", "health/fields/**"))


def _learning(task: Task) -> rrb.Tabs:
    paths = [holdout_path(task, group.name)[0] for group in reversed(task.groups)]
    holdout = [whole(f"Hold-out error: {path.rsplit('/', 1)[-1]}", f"{path}/**") for path in paths]
    calibration = whole("Calibration (1 is honest)", "learning/calibration/**")
    return rrb.Tabs(holdout[0], whole("Loss terms", "learning/loss/**"), calibration, *holdout[1:])


def _episodes() -> rrb.Tabs:
    final = whole("Error at the end of each episode", "episodes/final_error/**")
    return rrb.Tabs(whole("Return of each episode", "episodes/return/**"), final)


def _states() -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="state", name="Mode and source of actions")


def _log() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="log", name="Events", columns=columns)

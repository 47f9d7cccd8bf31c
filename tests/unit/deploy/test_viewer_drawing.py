"""What each message shows."""

from dataclasses import replace

import numpy as np
import pytest

from common.messages import Episode, Fallback, Header, Health, Metrics, Mode, Sample, Warmup
from deploy.viewer.curves import curves_of
from deploy.viewer.drawer import Drawer
from deploy.viewer.drawing import Event, Poses, Scalars, State, When
from deploy.viewer.steps import StepCounter
from services.sim.kinematics import SceneKinematics
from tests.unit.deploy.viewer_samples import PERIOD_NS, START_NS, chunk, step


@pytest.fixture(scope="module")
def kinematics():
    return {name: SceneKinematics(name) for name in ("reach", "egg", "die")}


@pytest.fixture
def drawer(kinematics):
    return Drawer(kinematics["reach"], PERIOD_NS, ghost=True)


def values(drawings, path):
    return [list(d.value.values) for d in drawings if d.path == path and isinstance(d.value, Scalars)]


def texts(drawings):
    return [d.value.text for d in drawings if isinstance(d.value, Event)]


def at(path, drawings):
    return [d.when.step for d in drawings if d.path == path]


def test_a_step_shows_hand_goal_distance_and_mode(drawer):
    goal = np.zeros(15, np.float32)
    goal[2] = 0.010  # first finger's goal is 10 mm above its tip
    drawings = drawer.draw(step("reach", 0, goal=goal))
    assert values(drawings, "goal/error_mm") == [pytest.approx([10, 0, 0, 0, 0, 2, 2])]
    poses = next(d.value for d in drawings if d.path == "world/hand")
    assert isinstance(poses, Poses)
    assert "goal_ff" in poses.frames
    assert len(poses.frames) == len(poses.positions)
    assert [d.value for d in drawings if d.path == "state/mode"] == [State("plan")]
    assert texts(drawings) == ["plant: episode 0 begins: plan"]
    assert all(d.when == When(0, START_NS, 0) for d in drawings)


def test_an_object_task_shows_position_and_rotation(kinematics):
    drawer = Drawer(kinematics["egg"], PERIOD_NS, ghost=False)
    drawings = drawer.draw(step("egg", 0))
    assert values(drawings, "goal/error_mm") == [pytest.approx([0, 5])]
    assert values(drawings, "goal/error_rad") == [pytest.approx([0, 0.5])]
    assert not [d for d in drawings if d.path == "world/ghost"]


def test_the_executed_action_is_drawn_where_it_began(drawer):
    drawer.draw(step("reach", 0))
    drawings = drawer.draw(step("reach", 1, prev_action=np.full(20, 0.25, np.float32)))
    assert values(drawings, "actions/executed") == [[0.25] * 5]
    assert at("actions/executed", drawings) == [0]


def test_a_plan_shows_committed_actions_cost_and_prediction(drawer):
    drawer.draw(step("reach", 0))
    drawings = drawer.draw(chunk("reach", 0))
    assert at("actions/planned", drawings) == [0, 1]
    assert values(drawings, "timing/plan_ms") == [[30.0, 80.0]]
    predicted = [d for d in drawings if d.path == "prediction/th_z_mm/predicted"]
    assert list(predicted[0].value.values) == pytest.approx([0, 200, -200])
    assert predicted[0].when == When(2, START_NS + 2 * PERIOD_NS, 0)
    ghost = next(d.value for d in drawings if d.path == "world/ghost")
    assert all(frame.startswith("ghost/") and "goal" not in frame for frame in ghost.frames)
    assert texts(drawings) == ["planner: plans with model abc"]


def test_a_prediction_is_compared_with_what_came(drawer):
    drawer.draw(step("reach", 0))
    drawer.draw(chunk("reach", 0))
    assert values(drawer.draw(step("reach", 1)), "prediction/z") == []
    state = np.zeros(63, np.float32)
    state[48:63] = 0.2  # two deviations at each fingertip coordinate
    assert values(drawer.draw(step("reach", 2, state=state)), "prediction/z") == [pytest.approx([0, 0, 2, 1])]


def test_late_and_held_steps_are_counted(drawer):
    drawer.draw(step("reach", 0))
    drawer.draw(chunk("reach", 0, seq=4))
    seen = [
        drawer.draw(step("reach", 1, chunk_seq=4, chunk_offset=0)),
        drawer.draw(step("reach", 2, chunk_seq=4, chunk_offset=2)),
        drawer.draw(step("reach", 3, fallback=Fallback.HOLD)),
        drawer.draw(step("reach", 4, fallback=Fallback.RELAX)),
    ]
    counts = [values(drawings, "timing/lost")[0] for drawings in seen]
    assert counts == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]]
    assert values(seen[1], "timing/age_ms") == [[40.0]]
    assert texts(seen[2]) == ["plant: step 3: no planned action left, hold"]


def test_a_plan_does_not_age_while_the_plant_waits_for_it(drawer):
    drawer.draw(step("reach", 0, waiting=True))
    drawer.draw(chunk("reach", 0, seq=4, source_t_ns=START_NS - 20 * 10**9))
    drawer.draw(step("reach", 0))
    drawings = drawer.draw(step("reach", 1, chunk_seq=4, chunk_offset=0))
    assert values(drawings, "timing/age_ms") == [[0.0]]


def test_the_end_of_an_episode_shows_return_and_verdict(drawer):
    goal = np.zeros(15, np.float32)
    goal[0] = 0.03
    drawer.draw(step("reach", 0, goal=goal))
    drawings = drawer.draw(step("reach", 1, goal=goal, last=True))
    assert values(drawings, "episodes/return/plan") == [pytest.approx([-0.03])]
    assert values(drawings, "episodes/final_error/plan") == [pytest.approx([6.0])]
    assert texts(drawings) == ["plant: episode 0 ends: goal not reached, 6 mm, return -0.03"]


def test_a_waiting_or_repeated_step_is_not_drawn_twice(drawer):
    assert drawer.draw(step("reach", 0, waiting=True)) == []
    assert drawer.draw(step("reach", 0))
    assert drawer.draw(step("reach", 0)) == []


def test_an_event_marks_a_new_goal_and_a_dropped_object(kinematics):
    drawer = Drawer(kinematics["egg"], PERIOD_NS, ghost=False)
    drawer.draw(step("egg", 0))
    shown = texts(drawer.draw(step("egg", 1, goal_seq=1, dropped=True)))
    assert shown == ["plant: step 1: goal 1 of the episode", "plant: step 1: object dropped"]
    assert texts(drawer.draw(step("egg", 2, goal_seq=1, dropped=True))) == []


def test_episodes_stand_behind_each_other():
    steps = StepCounter()
    assert steps.planned(7, 0, 0) is None
    assert steps.step(7, 0, 0) == 0
    steps.advance(50)
    assert steps.planned(7, 1, 0) == 51  # a plan may be the first that is heard of an episode
    assert steps.step(7, 0, 50) is None
    steps.advance(60)
    assert steps.step(9, 0, 3) == 64  # a restarted plant begins at episode 0 again
    assert steps.planned(7, 1, 12) is None  # and a plan for the one before it is ignored


def metrics(**changes):
    message = Metrics(
        after_episode=4,
        episodes=5,
        steps=250,
        updates=1000,
        snapshot_id="abc",
        update_ms=1500.0,
        loss={"nll": -3.0},
        holdout={"tips_h1": 0.004, "qpos_h5": 0.1},
        calibration={"tips": 1.2},
    )
    return Sample("learn/metrics", Header(9, 0, START_NS, True), replace(message, **changes))


def test_metrics_show_losses_and_hold_out_in_their_units(drawer):
    drawings = drawer.draw(metrics())
    assert values(drawings, "learning/loss/nll") == [[-3.0]]
    assert values(drawings, "learning/holdout/tips_mm/h1") == [[4.0]]
    assert values(drawings, "learning/holdout/qpos_rad/h5") == [[0.1]]
    assert values(drawings, "learning/calibration/tips") == [[1.2]]
    assert texts(drawings) == ["learner: model abc: 5 episodes, 250 steps, 1.5 s"]


def health(**changes):
    message = Health(
        service="sim",
        state="episode 3",
        loop_p50_ms=0.5,
        loop_p99_ms=2.0,
        ticks=10,
        overruns=1,
        stale_inputs=(),
        refused={"control/chunk": 2},
        dropped={"control/step": 3},
        config_hash="cafe",
        version="0.1",
        rss_mb=200.0,
        fields={"late": 4.0},
    )
    return Sample("health/sim", Header(7, 0, START_NS, True), replace(message, **changes))


def test_health_shows_loop_losses_and_changes_only(drawer):
    drawings = drawer.draw(health())
    assert values(drawings, "health/loop_p99_ms/sim") == [[2.0]]
    assert values(drawings, "health/lost/sim") == [[6.0]]
    assert values(drawings, "health/fields/sim/late") == [[4.0]]
    assert texts(drawings) == ["sim: episode 3 (version 0.1, config cafe)"]
    assert texts(drawer.draw(health())) == []
    assert texts(drawer.draw(health(stale_inputs=("control/chunk",)))) == ["sim: no fresh control/chunk"]
    assert texts(drawer.draw(health())) == ["sim: all inputs fresh"]


def test_a_wanted_episode_is_told(drawer):
    goal = np.zeros(0, np.float32)
    wanted = Episode(3, 0, goal, Mode.EVALUATE, Warmup.NONE, 50, 12)
    sample = Sample("task/episode", Header(9, 0, START_NS, True), wanted)
    assert texts(drawer.draw(sample)) == ["curriculum: wants episode 3: evaluate, 50 steps, seed 12"]


@pytest.mark.parametrize("task_name", ["reach", "egg", "die"])
def test_legends_fit_the_curves(kinematics, task_name):
    drawer = Drawer(kinematics[task_name], PERIOD_NS, ghost=False)
    samples = [step(task_name, 0), chunk(task_name, 0)]
    samples += [step(task_name, k, chunk_seq=0, chunk_offset=0, last=k == 2) for k in (1, 2)]
    drawn = {
        d.path: d.value.values.size for s in samples for d in drawer.draw(s) if isinstance(d.value, Scalars)
    }
    curves = {item.path: len(item.names) for item in curves_of(kinematics[task_name].task)}
    drawn = {path: size for path, size in drawn.items() if not path.startswith("hand/")}
    assert drawn == {path: size for path, size in curves.items() if path in drawn}
    assert {path for path in curves if not path.startswith("episodes/")} <= set(drawn)

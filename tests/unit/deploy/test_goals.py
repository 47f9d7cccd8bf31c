"""Which face the die is to show in which episode."""

import numpy as np
import pytest

from common.config import ConfigError
from common.messages import Mode
from common.task import get_task
from deploy.cell import load_cell
from deploy.curriculum_config import CurriculumConfig
from deploy.goals import goal_of
from deploy.schedule import Assignment
from tests.unit.deploy.scripted_cell import ScriptedCell, config

TASK = get_task("die")


def faces(plan, mode, count, task=TASK):
    """The faces of the first episodes of a kind; None where the plant decides."""
    goals = [goal_of(task, Assignment(episode=i, mode=mode, index=i, seed=i), plan) for i in range(count)]
    return [task.face_of(goal) if goal.size else None for goal in goals]


@pytest.mark.parametrize("task", [TASK, TASK.mirrored()], ids=["right", "left"])
def test_training_takes_one_face_after_the_other_and_evaluations_take_turns(task):
    plan = CurriculumConfig(goal_faces=(2, 4, 5), episodes=7)
    assert faces(plan, Mode.PLAN, 7, task) == [2, 2, 2, 4, 4, 5, 5]
    assert faces(plan, Mode.EVALUATE, 7, task) == [2, 4, 5, 2, 4, 5, 2]
    assert faces(plan, Mode.RANDOM, 2, task) == [None, None]
    assert goal_of(task, Assignment(episode=0, mode=Mode.PLAN, index=0, seed=0), plan).dtype == np.float32


def test_without_faces_or_a_die_the_seed_decides():
    plan = CurriculumConfig(episodes=3)
    assert faces(plan, Mode.PLAN, 3) == faces(plan, Mode.EVALUATE, 3) == [None] * 3
    some = CurriculumConfig(goal_faces=(2,), episodes=3)
    assert goal_of(get_task("reach"), Assignment(episode=0, mode=Mode.PLAN, index=0, seed=0), some).size == 0


def test_a_run_of_more_episodes_than_planned_stays_with_the_last_face():
    assert faces(CurriculumConfig(goal_faces=(2, 4), episodes=2), Mode.PLAN, 4) == [2, 4, 4, 4]
    assert faces(CurriculumConfig(goal_faces=(2, 4), episodes=0), Mode.PLAN, 1) == [2]


@pytest.mark.parametrize("name", ["die", "dexhand_twin"])
def test_the_cells_with_a_die_ask_for_faces_2_4_and_5_in_equal_shares(name):
    plan = load_cell(name).curriculum
    shown = faces(plan, Mode.PLAN, plan.episodes)
    assert shown == sorted(shown)
    assert [shown.count(face) for face in (2, 4, 5)] == [-(-(plan.episodes - i) // 3) for i in range(3)]
    assert plan.evaluate_goals % 3 == 0


def test_the_curriculum_publishes_these_goals(tmp_path):
    settings = config(tmp_path, goal_faces=(2, 4, 5)).model_copy(update={"task": "die"})
    cell = ScriptedCell(settings)
    cell.run()
    asked = [(e.mode, TASK.face_of(e.goal)) for e in cell.plant.seen if e.goal.size]
    trained = [face for mode, face in asked if mode is Mode.PLAN]
    evaluated = [face for mode, face in asked if mode is Mode.EVALUATE]
    assert (trained, evaluated) == ([2, 4, 5], [2, 4] * 3)


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        (["task=reach", "plant=sim"], "curriculum.goal_faces: task reach has no die"),
        (["hand.hand=left"], "task: die is none for the DexHand 021 .left.; it has: die_left"),
        (["task=die_left"], "task: die_left is none for the DexHand 021 .right.; it has: die"),
        (["curriculum.goal_faces=[7]"], "curriculum.goal_faces.0: .* less than or equal to 6"),
    ],
)
def test_a_cell_that_contradicts_itself_is_refused(overrides, complaint):
    with pytest.raises(ConfigError, match=complaint):
        load_cell("dexhand_twin", overrides)


def test_a_left_hand_is_two_values():
    cell = load_cell("dexhand_twin", ["task=die_left", "hand.hand=left"])
    assert get_task(cell.task).hand is cell.hand.hand

"""The case study's numbers are those of the episodes, and its pictures show hand, object and goal."""

import numpy as np
import pytest

from bench.case_study import Curve, Episode, curves_of, draw, errors_of, page
from bench.hand_frames import SIZE_PX, HandCamera
from common.task import get_task
from services.sim.plant import ShadowHandPlant

TURNED = [0.0, 1.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def egg():
    plant = ShadowHandPlant("egg_rotate", 1_000_000)
    return plant.task, plant.state, plant.goal


def columns_that_differ(one, other):
    return np.flatnonzero(np.any(one != other, axis=(0, 2)))


def test_a_frame_shows_the_object_in_the_hand_and_the_goal_beside_it(egg):
    task, state, goal = egg
    camera = HandCamera("egg_rotate")
    frame = camera.frame(state, goal)
    assert frame.shape == (SIZE_PX, SIZE_PX, 3)
    np.testing.assert_array_equal(camera.frame(state, goal), frame)
    other_goal = np.concatenate([goal[:3], TURNED])
    marker = columns_that_differ(camera.frame(state, other_goal), frame)
    turned = state.copy()
    turned[task.group("object_rotation").slice] = TURNED
    thing = columns_that_differ(camera.frame(turned, goal), frame)
    camera.close()
    assert len(thing) > 10 and len(marker) > 10
    assert thing.max() < marker.min()  # the goal's egg is drawn to the right of the hand's


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        ("reach", [("mean_finger_m", 2.0)]),
        ("egg_rotate", [("rotation_rad", 0.5)]),
        ("egg", [("rotation_rad", 0.5), ("position_m", 5.0)]),
    ],
)
def test_errors_are_those_that_the_paper_s_success_looks_at(task, expected):
    assert [(curve.key, curve.threshold) for curve in curves_of(get_task(task))] == expected


def test_a_curve_ends_where_the_object_is_lost(egg):
    task, state, goal = egg
    states = np.stack([state] * 4)
    states[2, task.group("object_position").stop - 1] = 0.04  # on the floor, and back by magic
    turn = Curve("rotation_rad", "", 1.0, 0.5)
    found = errors_of(task, Episode(goal, states), turn)
    assert found[0] == pytest.approx(float(task.errors(state, goal)["rotation_rad"]))
    np.testing.assert_array_equal(np.isnan(found), [False, False, True, True])


def test_pictures_are_small_and_the_page_tells_how_episodes_ended(egg, tmp_path):
    task, state, goal = egg
    reached = state.copy()
    reached[task.group("object_rotation").slice] = goal[3:]
    ended = {"ours": reached, "theirs": state}
    study = {name: [Episode(goal, np.stack([state, end]))] * 2 for name, end in ended.items()}
    draw(task, study, tmp_path)
    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert sorted(sizes) == [f"case_study_egg_rotate{end}.png" for end in ("", "_goal_1", "_goal_2")]
    assert all(3_000 < size < 500_000 for size in sizes.values())
    text = page(task, study)
    left = 2 * np.arccos(abs(state[task.group("object_rotation").slice] @ goal[3:]))
    assert left > 0.5
    assert "| ours | 0.00 | yes | no |" in text and f"| theirs | {left:.2f} | no | no |" in text
    assert all(f"]({name})" in text for name in sizes)

"""The die task: Eq. (2), the penalty for a drop as a function of the state, goals, and success by face."""

import math

import numpy as np
import pytest
import torch

from common.dexhand021.tables import Hand
from common.task import get_die_task, get_task

TASK = get_task("die")
FLAT = np.concatenate([np.zeros(17), TASK.goal(1)])


def poses(n, seed=0):
    """States (n, 24) with the die anywhere, goals (n, 7)."""
    rng = np.random.default_rng(seed)
    state, goal = rng.normal(size=(n, 24)), rng.normal(size=(n, 7))
    state[:, 20:] /= np.linalg.norm(state[:, 20:], axis=1, keepdims=True)
    goal[:, 3:] /= np.linalg.norm(goal[:, 3:], axis=1, keepdims=True)
    return state, goal


def equation_2(state, goal):
    """Eq. (2) and the penalty as the paper prints them, for one state."""
    p, q = state[17:20], state[20:24]
    reward = -(0.1 * math.dist(p, goal[:3]) + 2 * math.acos(min(1.0, abs(float(q @ goal[3:])))))
    lower = math.cos(math.radians(15)) * p[0] - math.sin(math.radians(15)) * p[1] < 0.0
    return reward - 2 * lower


def test_the_reward_is_equation_2_with_two_less_for_a_drop():
    state, goal = poses(200)
    expected = [equation_2(s, g) for s, g in zip(state, goal, strict=True)]
    assert np.allclose(TASK.reward(state, goal), expected, atol=1e-7)
    assert np.array_equal(TASK.env_reward(state, goal), TASK.reward(state, goal))
    assert 20 < TASK.dropped(state).sum() < 180


def test_the_reward_is_differentiable_and_blind_to_the_sign():
    state, goal = (torch.from_numpy(x) for x in poses(50))
    state.requires_grad_()
    reward = TASK.reward(state, goal)
    reward.sum().backward()
    assert torch.isfinite(state.grad).all()
    assert (state.grad[:, :17] == 0).all()
    flipped = goal * torch.tensor([1, 1, 1, -1, -1, -1, -1])
    assert torch.allclose(TASK.reward(state, flipped), reward)
    on_goal = torch.from_numpy(FLAT).requires_grad_()
    TASK.reward(on_goal, torch.from_numpy(TASK.goal(1))).backward()
    assert torch.isfinite(on_goal.grad).all()


def test_numpy_and_torch_agree_in_everything():
    state, goal = poses(64, seed=1)
    goal[:16, 3:] = state[:16, 20:]
    tensors = torch.from_numpy(state), torch.from_numpy(goal)
    for name, value in {**TASK.errors(state, goal), **TASK.successes(state, goal)}.items():
        other = {**TASK.errors(*tensors), **TASK.successes(*tensors)}[name]
        assert np.allclose(value, other.numpy(), atol=1e-6), name
    single = TASK.successes(tensors[0].float(), tensors[1][0].float())
    assert single["success_paper"].shape == (64,)


@pytest.mark.parametrize("face", [2, 4, 5])
def test_each_goal_is_a_quarter_turn_away_and_its_face_counts_however_turned(face):
    goals = TASK.goals(face, 4)
    assert np.array_equal(goals[0], TASK.goal(face))
    assert TASK.errors(FLAT, goals[0])["rotation_rad"] == pytest.approx(np.pi / 2)
    assert not TASK.successes(FLAT, goals[0])["success_paper"]
    for turned in goals:
        state = np.concatenate([np.zeros(17), turned])
        verdict = TASK.successes(state, goals[0])
        assert verdict["success_paper"]
        assert bool(verdict["success_env"]) == (turned is goals[0] or np.array_equal(turned, goals[0]))
        assert TASK.errors(state, goals[0])["lean_rad"] == pytest.approx(0.0, abs=1e-6)


def test_a_dropped_die_is_no_success():
    state = FLAT.copy()
    state[17] = -0.1
    assert TASK.dropped(state)
    assert not any(TASK.successes(state, TASK.goal(1)).values())
    assert all(TASK.successes(FLAT, TASK.goal(1)).values())


def test_implausible_states_are_named_as_such():
    state = np.tile(FLAT, (5, 1))
    state[1, 3], state[2, 13], state[3, 19], state[4, 20:] = np.nan, 1e3, 2.0, 0.1
    assert TASK.plausible(state).tolist() == [True, False, False, False, False]
    assert TASK.plausible(torch.from_numpy(state)).tolist() == [True, False, False, False, False]


def test_a_left_hand_has_its_thumb_on_the_other_side():
    left = TASK.mirrored()
    assert left.up == (TASK.up[0], -TASK.up[1], TASK.up[2])
    assert (left.name, left.hand) == ("die_left", Hand.LEFT)
    assert left.mirrored() == TASK
    assert get_task("die_left") == left


def test_a_die_beside_the_thumb_is_lower_in_the_one_hand_and_higher_in_the_other():
    state = FLAT.copy()
    state[17:20] = 0.01, 0.06, 0.15  # the palm is rolled by 15 degrees: 16 mm down, or up
    assert TASK.dropped(state)
    assert not TASK.mirrored().dropped(state)


def test_only_the_hands_own_task_is_given():
    assert get_die_task("die", Hand.RIGHT) == TASK
    assert get_die_task("die_left", Hand.LEFT) == TASK.mirrored()
    for name, hand, other in (("die", Hand.LEFT, "die_left"), ("die_left", Hand.RIGHT, "die")):
        with pytest.raises(ValueError, match=f"task: {name} is none .* it has: {other}$"):
            get_die_task(name, hand)


@pytest.mark.parametrize("task", [TASK, TASK.mirrored()], ids=["right", "left"])
def test_a_goal_tells_its_face(task):
    for face in range(1, 7):
        assert [task.face_of(goal) for goal in task.goals(face)] == [face] * 4


def test_goals_are_drawn_evenly_from_the_papers_faces():
    faces = [TASK.face_of(TASK.draw_goal(np.random.default_rng(seed))) for seed in range(300)]
    assert {face: faces.count(face) > 70 for face in faces} == {2: True, 4: True, 5: True}


@pytest.mark.parametrize("task", [TASK, TASK.mirrored()], ids=["right", "left"])
def test_straying_and_sinking_are_measured_from_the_start_against_gravity(task):
    state = np.zeros((4, task.state_dim))
    pose = slice(task.state_dim - 7, task.state_dim)
    state[:, pose] = (*task.start_position, *task.start_rotation)
    state[1, pose.start : pose.start + 3] += 0.03 * np.array(task.up)
    state[2, pose.start : pose.start + 3] -= 0.03 * np.array(task.up)
    state[3, pose.start + 2] += 0.05
    assert np.allclose(task.sinking(state), [0.0, 0.0, 0.03, 0.0], atol=1e-6)
    assert np.allclose(task.straying(state), [0.0, 0.0, 0.0, 0.05 - task.middle_radius_m], atol=1e-5)

"""Rewards match on both libraries, and the planner's reward ignores a quaternion's sign."""

import numpy as np
import pytest
import torch

from common import geometry
from common.task import TASKS, get_task

OBJECT_TASKS = ("egg", "egg_rotate", "block")
SHADOW_HAND = ("reach", *OBJECT_TASKS)


def random_states(task, n, seed=0):
    """States (n, S) and goals (n, G), a quarter of the goals within the success thresholds."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(n, task.state_dim))
    if task.goal_dim == 7:
        state[:, -4:] = geometry.normalise(state[:, -4:])
    goal = rng.normal(size=(n, task.goal_dim))
    goal[: n // 4] = task.achieved(state)[: n // 4] + rng.normal(scale=3e-3, size=(n // 4, task.goal_dim))
    if task.goal_dim == 7:
        goal[:, 3:] = geometry.normalise(goal[:, 3:])
    return state, goal


@pytest.mark.parametrize("name", TASKS)
def test_groups_tile_the_state_in_order(name):
    task = get_task(name)
    assert task.groups[0].start == 0
    for before, after in zip(task.groups, task.groups[1:], strict=False):
        assert before.stop == after.start
    sizes = (task.state_dim, task.goal_dim, task.action_dim, len(task.joint_names))
    die = dict.fromkeys(("die", "die_left"), (24, 7, 12, 12))
    assert sizes == ({"reach": (63, 15, 20, 24)} | die).get(name, (61, 7, 20, 24))
    assert task.action_dim == len(task.actuator_names)


@pytest.mark.parametrize("name", TASKS)
def test_torch_and_numpy_agree(name):
    task = get_task(name)
    state, goal = random_states(task, 64)
    theirs = torch.from_numpy(state), torch.from_numpy(goal)
    for ours, other in [
        (task.reward(state, goal), task.reward(*theirs)),
        (task.env_reward(state, goal), task.env_reward(*theirs)),
    ]:
        assert ours.shape == (64,)
        assert np.allclose(ours, other.numpy(), atol=1e-6)
    for ours, other in [
        (task.errors(state, goal), task.errors(*theirs)),
        (task.successes(state, goal), task.successes(*theirs)),
    ]:
        assert ours.keys() == other.keys()
        for key, value in ours.items():
            assert np.allclose(value, other[key].numpy(), atol=1e-6), key


@pytest.mark.parametrize("name", TASKS)
def test_any_batch_shape_and_one_goal_for_all(name):
    task = get_task(name)
    state, goal = random_states(task, 24)
    batch = torch.from_numpy(state).reshape(2, 3, 4, -1)
    reward = task.reward(batch, torch.from_numpy(goal[0]))
    assert reward.shape == (2, 3, 4)
    assert reward[1, 2, 3].item() == pytest.approx(float(task.reward(state[23], goal[0])))
    assert {tuple(v.shape) for v in task.successes(batch, torch.from_numpy(goal[0])).values()} == {(2, 3, 4)}


@pytest.mark.parametrize("name", TASKS)
def test_the_residuals_norms_add_up_to_the_reward(name):
    task = get_task(name)
    state, goal = random_states(task, 64)
    norms = sum(np.linalg.norm(part, axis=-1) for part in task.residuals(state, goal))
    events = task.drop_penalty * task.dropped(state) if hasattr(task, "drop_penalty") else 0.0
    assert np.allclose(-norms - events, task.reward(state, goal), atol=1e-6)
    one_goal = task.residuals(torch.from_numpy(state).reshape(2, 32, -1), torch.from_numpy(goal[0]))
    assert {tuple(part.shape[:-1]) for part in one_goal} == {(2, 32)}


@pytest.mark.parametrize("name", OBJECT_TASKS)
def test_only_the_environments_reward_sees_the_sign_of_a_quaternion(name):
    task = get_task(name)
    state, goal = random_states(task, 64)
    flipped = goal * np.array([1, 1, 1, -1, -1, -1, -1])
    assert np.allclose(task.reward(state, goal), task.reward(state, flipped))
    assert np.allclose(task.errors(state, goal)["rotation_rad"], task.errors(state, flipped)["rotation_rad"])
    assert not np.allclose(task.env_reward(state, goal), task.env_reward(state, flipped))


def test_reach_success_by_three_norms():
    task = get_task("reach")
    state, goal = np.zeros(63), np.zeros(15)
    state[48] = 0.009  # one finger is off by 9 mm: 1.8 mm on average, 9 mm at worst and by 15-D norm
    assert task.errors(state, goal)["mean_finger_m"] == pytest.approx(0.0018)
    assert {k: bool(v) for k, v in task.successes(state, goal).items()} == {
        "success_paper": True,
        "success_worst": False,
        "success_15d": False,
        "success_env": True,
    }


@pytest.mark.parametrize(("name", "paper"), [("egg", False), ("egg_rotate", True), ("block", True)])
def test_position_counts_for_the_egg_alone(name, paper):
    task = get_task(name)
    state, goal = np.zeros(61), np.zeros(7)
    state[57], goal[3] = 1.0, 1.0
    state[54] = 0.007  # 7 mm: between the paper's 5 mm and the environment's 10 mm
    verdict = task.successes(state, goal)
    assert bool(verdict["success_paper"]) == paper
    assert bool(verdict["success_env"])


@pytest.mark.parametrize("name", SHADOW_HAND)
def test_implausible_states_are_named_as_such(name):
    task = get_task(name)
    state = np.zeros((4, task.state_dim))
    if name in OBJECT_TASKS:
        state[:, 57] = 1.0
    state[1, 3] = np.nan
    state[2, 30] = 1e3
    state[3, -1] = np.inf
    assert task.plausible(state).tolist() == [True, False, False, False]
    assert task.plausible(torch.from_numpy(state)).tolist() == [True, False, False, False]


def test_an_object_below_the_hand_is_dropped():
    state = np.zeros((2, 61))
    state[:, 56] = 0.12, 0.03
    for name in OBJECT_TASKS:
        assert get_task(name).dropped(state).tolist() == [False, True]
        assert get_task(name).dropped(torch.from_numpy(state)).tolist() == [False, True]
    for reach in (np.zeros((2, 63)), torch.zeros(2, 63)):
        assert get_task("reach").dropped(reach).tolist() == [False, False]


def test_a_collapsed_quaternion_is_implausible():
    state = np.zeros(61)
    state[57] = 0.1
    assert not get_task("egg").plausible(state)


def test_an_unknown_task_is_refused_by_name():
    with pytest.raises(ValueError, match="reach, egg, egg_rotate, block, die"):
        get_task("pen")
    with pytest.raises(KeyError, match="tips"):
        get_task("reach").group("object_rotation")

"""The plant is exactly repeatable, refuses bad input unmoved, and its rewards are the environment's."""

import logging

import numpy as np
import pytest

from common.messages import PlantCommand
from common.task import TASKS, get_task
from services.sim import plant as plant_module
from services.sim.build import HEAD_START_S, SimProcess, build, build_live
from services.sim.plant import ENV_IDS, ShadowHandPlant

plants = pytest.mark.parametrize("name", ENV_IDS)


@pytest.fixture(scope="module")
def make():
    """One plant per task for the whole module, already used: nothing may depend on what came before."""
    built = {}

    def get(name):
        if name not in built:
            built[name] = ShadowHandPlant(name, seed=3)
            built[name].step(np.ones(20))
        return built[name]

    return get


def actions(n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 20)).astype(np.float32)


def roll(plant, sequence):
    return np.array([plant.step(action) for action in sequence])


@plants
def test_same_seed_and_actions_give_the_same_states_in_any_process_history(make, name):
    fresh, used = ShadowHandPlant(name, seed=11), make(name)
    start = used.reset(11)
    assert np.array_equal(start.state, fresh.state)
    assert np.array_equal(start.goal, fresh.goal)
    assert np.array_equal(roll(used, actions(50)), roll(fresh, actions(50)))
    assert not np.array_equal(start.state, used.reset(12).state) or name == "reach"


@plants
def test_restore_continues_exactly(make, name):
    plant = make(name)
    plant.reset(5)
    roll(plant, actions(10, seed=1))
    snapshot = plant.save()
    first = roll(plant, actions(20, seed=2))
    plant.reset(6)
    restored = plant.restore(snapshot)
    assert np.array_equal(plant.state, restored.state)
    assert np.array_equal(plant.goal, snapshot.observed.goal)
    assert np.array_equal(roll(plant, actions(20, seed=2)), first)


@plants
def test_a_snapshot_does_not_follow_the_plant(make, name):
    plant = make(name)
    snapshot = plant.save()
    physics, state = snapshot.physics.copy(), snapshot.observed.state.copy()
    plant.step(np.zeros(20))
    plant.goal[:] = 0.0
    assert np.array_equal(snapshot.physics, physics)
    assert np.array_equal(snapshot.observed.state, state)


@plants
def test_our_environment_reward_is_the_environments(make, name):
    plant, task = make(name), get_task(name)
    for seed in range(4):
        goal = plant.reset(seed).goal
        for action in actions(50, seed):
            _, reward, _, _, info = plant.env.step(action)
            observation = plant.env._get_obs()
            state = observation["observation"]
            assert np.array_equal(task.achieved(state), observation["achieved_goal"])
            assert task.env_reward(state, goal) == pytest.approx(reward, abs=1e-12)
            assert bool(task.successes(state, goal)["success_env"]) == bool(info["is_success"])


@plants
def test_our_environment_reward_is_the_environments_on_random_states(make, name):
    env, task, rng = make(name).env, get_task(name), np.random.default_rng(0)
    state, goal = rng.normal(size=(300, task.state_dim)), rng.normal(size=(300, task.goal_dim))
    goal[:100] = task.achieved(state)[:100] + rng.normal(scale=3e-3, size=(100, task.goal_dim))
    if task.goal_dim == 7:
        state[:, 57:] /= np.linalg.norm(state[:, 57:], axis=-1, keepdims=True)
        goal[:, 3:] /= np.linalg.norm(goal[:, 3:], axis=-1, keepdims=True)
    achieved = task.achieved(state)
    assert np.allclose(task.env_reward(state, goal), env.compute_reward(achieved, goal, {}), atol=1e-12)
    assert np.array_equal(task.successes(state, goal)["success_env"], env._is_success(achieved, goal) > 0)


@plants
def test_real_states_are_plausible_and_quaternions_unit(make, name):
    plant, task = make(name), get_task(name)
    plant.reset(1)
    states = roll(plant, actions(60))  # past 50 steps: the plant has no time limit
    assert task.plausible(states).all()
    if task.goal_dim == 7:
        assert np.allclose(np.linalg.norm(states[:, 57:], axis=-1), 1.0)


@plants
@pytest.mark.parametrize("bad", [np.full(20, np.nan), np.full(20, np.inf), np.zeros(19), np.zeros((1, 20))])
def test_bad_actions_are_refused_and_nothing_moves(make, name, bad):
    plant = make(name)
    before = plant.save().physics
    with pytest.raises(ValueError, match="20 finite"):
        plant.step(bad)
    assert np.array_equal(plant.save().physics, before)


def test_actions_are_clipped(make):
    plant = make("reach")
    plant.reset(0)
    beyond = plant.step(np.full(20, 7.0))
    plant.reset(0)
    assert np.array_equal(plant.step(np.ones(20)), beyond)


@plants
def test_a_given_goal_is_used_and_changes_nothing_else(make, name):
    plant = make(name)
    own = plant.reset(8)
    goal = plant.sample_goal(9)
    assert not np.array_equal(goal, own.goal)
    given = plant.reset(8, goal)
    assert np.array_equal(given.goal, goal)
    assert np.array_equal(given.state, own.state)
    assert np.array_equal(plant.env.goal, goal)
    for bad in (goal[:-1], goal * np.nan):
        with pytest.raises(ValueError, match="finite"):
            plant.set_goal(bad)


@plants
def test_sampling_a_goal_does_not_disturb_the_episode(make, name):
    plant = make(name)
    plant.reset(8)
    undisturbed = roll(plant, actions(10))
    plant.reset(8)
    first = roll(plant, actions(10)[:5])
    goal = plant.sample_goal(9)
    assert np.array_equal(np.concatenate([first, roll(plant, actions(10)[5:])]), undisturbed)
    assert np.array_equal(goal, plant.reset(9).goal)


@plants
def test_bodies_follow_hand_object_and_goal(make, name):
    plant = make(name)
    plant.reset(8)
    names, positions, quaternions = plant.bodies()
    assert len(set(names)) == len(names) == len(positions) == len(quaternions)
    assert np.allclose(np.linalg.norm(quaternions, axis=-1), 1.0)
    goal = positions[[i for i, body in enumerate(names) if body.startswith("goal")]]
    if name == "reach":
        assert np.array_equal(goal.ravel(), plant.goal)
        return
    assert np.allclose(positions[names.index("object")], plant.state[54:57], atol=1e-3)
    assert np.array_equal(quaternions[names.index("goal")], plant.goal[3:])
    assert np.allclose(goal[0] - plant.goal[:3], 0 if name == "egg" else [0.15, 0, 0])


def test_chance_is_where_it_was_measured(make):
    """Zero or random control: about -6 for reach, -140 for the egg (environment's rewards over 50 steps)."""
    for name, low, high, control in [("reach", -8, -4, actions(50)), ("egg", -250, -60, np.zeros((50, 20)))]:
        plant, returns = make(name), []
        for seed in range(6):
            goal = plant.reset(seed).goal
            returns.append(plant.task.env_reward(roll(plant, control), goal).sum())
        assert low < np.mean(returns) < high


def test_every_task_has_an_environment_and_no_other_has():
    assert {*ENV_IDS, "die", "die_left"} == set(TASKS)
    with pytest.raises(ValueError, match="pen"):
        ShadowHandPlant("pen")


def test_mujoco_warnings_go_to_the_log_and_leave_no_file(make, tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    plant = make("reach")
    plant.reset(0)
    plant.data.qvel[:] = 1e12
    with caplog.at_level(logging.WARNING, logger=plant_module.__name__):
        plant.step(np.zeros(20))
    assert caplog.records
    assert not list(tmp_path.iterdir())


def test_live_the_state_gets_a_head_start_before_the_physics(monkeypatch):
    waited = []
    monkeypatch.setattr("services.sim.port.time.sleep", waited.append)
    command = PlantCommand(True, 0, np.zeros(0, np.float32), np.zeros(20, np.float32))
    for make in (build, build_live):
        port = make(SimProcess(task="reach"), 1).ports["plant"]
        port.open(lambda _topic, _message: None)
        port.write(command)
    assert waited == [0.0, HEAD_START_S]

"""`DexHandDie-v0` is a proper Gymnasium environment: checked, vectorised, relabelled, drawn."""

import os
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from services.sim.gym_env import DexHandDieEnv

NAME = "services.sim.gym_env:DexHandDie-v0"
RENDER = """
import warnings
import gymnasium
from gymnasium.utils.env_checker import check_env
env = gymnasium.make("services.sim.gym_env:DexHandDie-v0", render_mode="rgb_array", size=(96, 128))
env.reset(seed=0)
image = env.render()
assert image.shape == (96, 128, 3) and image.dtype == "uint8", image.shape
assert image.std() > 10
warnings.simplefilter("error")
check_env(env.unwrapped)
env.close()
"""


@pytest.fixture
def env():
    made = gymnasium.make(NAME)
    yield made
    made.close()


def test_gymnasiums_own_checker_is_content(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)


def test_a_left_hand_has_the_mirrored_task():
    left = DexHandDieEnv(hand="left")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(left, skip_render_check=True)
    poses = np.array([[0.01, side, 0.15, *left._twin.task.start_rotation] for side in (0.06, -0.06)])
    for env, dropped in ((left, [False, True]), (DexHandDieEnv(), [True, False])):
        penalty = env.compute_reward(poses, poses, {})
        assert penalty.tolist() == [-2.0 * d for d in dropped]


def test_an_episode_has_fifty_steps_or_ends_with_a_drop(env):
    env.reset(seed=1)
    still = env.unwrapped._twin.joint_angles_rad
    action = 2 * still / env.unwrapped._twin.model.actuator_ctrlrange[:, 1] - 1
    for number in range(1, 51):
        observation, reward, terminated, truncated, info = env.step(action.astype(np.float32))
        assert not terminated
        assert truncated == (number == 50)
    assert -1.7 < reward < -1.4  # the die has not turned
    assert not info["is_success"]
    env.reset(seed=1)
    env.unwrapped._twin.place_die((0.1, -0.2, 0.1), (1.0, 0.0, 0.0, 0.0))
    ends = [env.step(action.astype(np.float32))[1:3] for _ in range(2)]
    assert ends[-1][1]
    assert ends[-1][0] < -2.0
    assert observation["observation"].shape == (24,)


def test_rewards_can_be_computed_anew_for_other_goals(env):
    observation, _ = env.reset(seed=2)
    achieved = np.stack([observation["achieved_goal"]] * 3)
    others = np.stack([env.unwrapped._twin.task.goal(face) for face in (1, 2, 6)])
    rewards = env.unwrapped.compute_reward(achieved, others, [{}] * 3)
    assert rewards.shape == (3,)
    assert rewards == pytest.approx([0.0, -np.pi / 2, -np.pi], abs=0.1)


def test_faces_and_goals_can_be_chosen(env):
    task = env.unwrapped._twin.task
    asked = [env.reset(seed=seed)[0]["desired_goal"] for seed in range(20)]
    assert {int(task.die.uppermost(goal[3:], task.up)) for goal in asked} == {2, 4, 5}
    chosen, _ = env.reset(seed=0, options={"face": 3})
    assert np.array_equal(chosen["desired_goal"], task.goal(3))
    own = task.goals(2, 4)[1]
    assert np.array_equal(env.reset(options={"goal": own})[0]["desired_goal"], own)
    for faces in ((), (0,), (7,)):
        with pytest.raises(ValueError, match="1 to 6"):
            DexHandDieEnv(faces=faces)
    with pytest.raises(ValueError, match="human"):
        DexHandDieEnv(render_mode="human")


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_it_vectorises(mode):
    envs = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode=mode, faces=(1, 6))
    first, _ = envs.reset(seed=5)
    assert first["observation"].shape == (2, 24)
    observation, reward, *_ = envs.step(np.zeros((2, 12), np.float32))
    assert reward.shape == (2,)
    assert envs.single_observation_space.contains({key: value[0] for key, value in observation.items()})
    envs.close()


def test_it_renders_and_passes_the_checker_so_where_there_is_opengl():
    ran = subprocess.run(
        [sys.executable, "-c", RENDER],
        env={**os.environ, "MUJOCO_GL": "egl"},
        capture_output=True,
        text=True,
        check=False,
    )
    if "OpenGL" in ran.stderr or "EGL" in ran.stderr:
        pytest.skip(f"no software OpenGL here: {ran.stderr.strip().splitlines()[-1]}")
    assert ran.returncode == 0, ran.stderr

"""Two tasks with known answers, and the plainest loop that trains a controller on one of them."""

from dataclasses import dataclass

import numpy as np

from bench.baselines.controller import Trajectory, derived_seed
from common.geometry import namespace
from common.task import Group, Task


@dataclass(frozen=True)
class PointMass(Task):
    """A point in the square moves by a fifth of its action; the reward is minus its distance to the goal."""

    name: str = "point"
    groups: tuple[Group, ...] = (Group("position", 0, 2, "m", -2.0, 2.0),)
    goal_dim: int = 2
    action_dim: int = 2
    steps: int = 10

    def start(self, rng):
        return rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)

    def move(self, state, action):
        return np.clip(state + 0.2 * action, -1, 1)

    def best_action(self, state, goal):
        return np.clip((goal - state) / 0.2, -1, 1)

    def achieved(self, state):
        return state

    def compute_reward(self, achieved, goal):
        return -namespace(achieved).linalg.vector_norm(achieved - goal, axis=-1)

    def dropped(self, state):
        return state[..., 0] > np.inf

    def reward(self, state, goal):
        return self.env_reward(state, goal)

    def residuals(self, state, goal):
        return (state - goal,)

    def errors(self, state, goal):
        return {"distance_m": -self.reward(state, goal)}

    def successes(self, state, goal):
        return {name: self.reward(state, goal) > -0.05 for name in ("success_paper", "success_env")}


@dataclass(frozen=True)
class Dials(PointMass):
    """Four dials, each turned by half its action: -1 until all are as wanted, then 0, as in bit flipping.

    A random posture is right once in some ten thousand: only goals that are pretended afterwards ever teach.
    """

    name: str = "dials"
    groups: tuple[Group, ...] = (Group("dials", 0, 4, "1", -1.0, 1.0),)
    goal_dim: int = 4
    action_dim: int = 4

    def start(self, rng):
        return rng.uniform(-1, 1, 4), rng.uniform(-1, 1, 4)

    def move(self, state, action):
        return np.clip(state + 0.5 * action, -1, 1)

    def best_action(self, state, goal):
        return np.clip((goal - state) / 0.5, -1, 1)

    def compute_reward(self, achieved, goal):
        return np.where(np.abs(achieved - goal).max(axis=-1) < 0.2, 0.0, -1.0)

    def successes(self, state, goal):
        return {name: self.reward(state, goal) == 0 for name in ("success_paper", "success_env")}


def episode(task, choose, seed, planned=True):
    """Run one episode from the start of `seed` with the actions of choose(state, goal)."""
    rng = np.random.default_rng(seed)
    state, goal = (part.astype(np.float32) for part in task.start(rng))
    states, actions = [state], []
    for _ in range(task.steps):
        actions.append(np.asarray(choose(states[-1], goal), np.float32))
        states.append(task.move(states[-1], actions[-1]).astype(np.float32))
    rewards = task.env_reward(np.array(states[1:]), goal).astype(np.float32)
    return Trajectory(np.array(states), np.array(actions), rewards, goal, planned)


def remember_warm_up(controller, task, episodes, seed=0):
    """Show it random episodes."""
    rng = np.random.default_rng(seed)
    for number in range(episodes):
        draw = lambda state, goal: rng.uniform(-1, 1, task.action_dim)  # noqa: E731
        controller.remember(episode(task, draw, derived_seed(seed, "warm-up", number), planned=False))


def warm_up(controller, task, episodes, seed=0):
    """Random episodes, and as many updates as they have steps."""
    remember_warm_up(controller, task, episodes, seed)
    return controller.learn(episodes * task.steps, derived_seed(seed, "learn", 0))


def train(controller, task, warmups, episodes, seed=0):
    """The bench's protocol in small: warm-up, then an update per step after each episode."""
    warm_up(controller, task, warmups, seed)
    for number in range(episodes):
        controller.begin(derived_seed(seed, "act", number), explore=True)
        controller.remember(episode(task, controller.act, derived_seed(seed, "train", number)))
        controller.learn(task.steps, derived_seed(seed, "learn", 1 + number))


def evaluate(controller, task, goals=20):
    """Mean return over held-out goals, and that of the best possible actions."""
    returns = []
    for number in range(goals):
        controller.begin(number, explore=False)
        pair = [episode(task, choose, 10**6 + number) for choose in (controller.act, task.best_action)]
        returns.append([trajectory.rewards.sum() for trajectory in pair])
    return np.mean(returns, axis=0)

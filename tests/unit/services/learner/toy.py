"""A linear system with known noise, small enough to learn in a second."""

from dataclasses import dataclass

import numpy as np

from common.model.config import ModelConfig
from common.task.layout import Group
from services.learner.episode import Episode
from services.learner.replay import Replay

A_MATRIX = np.array([[0.95, 0.10, 0.0], [-0.10, 0.95, 0.0], [0.0, 0.0, 0.9]])
B_MATRIX = np.array([[0.0, 0.1], [0.2, 0.0], [0.1, 0.1]])
NOISE = np.array([0.02, 0.1, 0.05])
SMALL = ModelConfig(members=2, hidden=(16, 16), dropout=0.0, targets="standardised")


@dataclass(frozen=True)
class Layout:
    """Three numbers in two groups."""

    name: str = "toy"
    groups: tuple[Group, ...] = (Group("first", 0, 2, "m", -9, 9), Group("second", 2, 3, "m", -9, 9))
    state_dim: int = 3
    action_dim: int = 2


def linear_episode(number, steps=50, mode="random"):
    rng = np.random.default_rng(number)
    states, actions = np.zeros((steps + 1, 3)), rng.uniform(-1, 1, (steps, 2))
    states[0] = rng.normal(size=3)
    for t in range(steps):
        states[t + 1] = A_MATRIX @ states[t] + B_MATRIX @ actions[t] + NOISE * rng.normal(size=3)
    return Episode(
        7,
        number,
        mode,
        states.astype("f4"),
        actions.astype("f4"),
        np.zeros(3, "f4"),
        np.ones(steps + 1, bool),
    )


def linear_replay(episodes=40, holdout=0.0):
    replay = Replay(3, 2, holdout)
    for number in range(episodes):
        replay.add(linear_episode(number))
    return replay

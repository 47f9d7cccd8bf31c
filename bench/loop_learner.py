"""Training data for the learner of `bench.loop`: real steps of the simulated hand, in its own store."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from common.warmup import WarmupActions
from services.learner.dataset import EpisodeStore
from services.learner.episode import Episode
from services.sim.plant import ShadowHandPlant

STEPS = 50  # of an episode, as in the paper's tasks


def fill_store(directory: Path, task_name: str, episodes: int, seed: int = 0) -> int:
    """Record random episodes where a learner finds them at its start; returns how many steps there are."""
    plant = ShadowHandPlant(task_name)
    store = EpisodeStore(directory, plant.task.state_dim, plant.task.action_dim)
    for number in range(episodes):
        store.append(_episode(plant, number, seed))
    return store.replay.steps


def _episode(plant: ShadowHandPlant, number: int, seed: int) -> Episode:
    draws = WarmupActions("mix", plant.task.action_dim, seed, number)
    start = plant.reset(seed + number)
    actions = np.stack([next(draws) for _ in range(STEPS)])
    states = np.stack([start.state, *(plant.step(action) for action in actions)])
    return Episode(
        boot_id=1,
        episode=number,
        mode="random",
        states=states.astype(np.float32),
        actions=actions,
        goal=start.goal.astype(np.float32),
        valid=np.ones(STEPS + 1, np.bool_),
    )

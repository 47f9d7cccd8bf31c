"""DDPG + HER by stable-baselines3: Andrychowicz et al., "Hindsight Experience Replay", NeurIPS 2017.

Settings are those of OpenAI's code for the hand tasks (openai/baselines, her/experiment/config.py). A
pretended goal is rewarded by the environment's own function, here the dense one.

Deviations:
* One update per step, 50 after each episode, and one worker; theirs are 40 batches for every two episodes of
  each of 19 workers. 5000 warm-up steps of the bench and as many updates before the first own episode.
* No penalty on the actor's pre-activations and no clipping of targets: stable-baselines3 has neither.
* Observations are standardised by the warm-up; theirs by all data so far, with the same bounds.
* Discount 1 - 1/50, their rule, for episodes of 50 steps.
"""

from __future__ import annotations

import numpy as np
from stable_baselines3 import DDPG, HerReplayBuffer

from bench.baselines.controller import Float32
from bench.baselines.stable import GoalSpaces, StableController, build, networks
from common.config import Frozen
from common.task import Task


class Config(Frozen):
    """Settings of OpenAI's code."""

    learning_rate: float = 1e-3
    discount: float = 0.98
    tau: float = 0.05  # polyak 0.95
    hidden: tuple[int, ...] = (256, 256, 256)
    batch: int = 256
    noise: float = 0.2  # deviation of what is added to actions in training
    random_share: float = 0.3  # of actions that are drawn uniformly instead
    relabelled_per_real: int = 4  # k, pretended goals for each real one
    strategy: str = "future"  # a goal that the same episode attained later
    buffer: int = 400_000  # steps; more than any run here has


class Agent(StableController):
    """A `Controller`."""

    def __init__(self, config: Config, task: Task, seed: int) -> None:
        # --- the method ---
        def make(env: GoalSpaces) -> DDPG:
            """The algorithm over the task's spaces; it never steps `env`."""
            return DDPG(
                "MultiInputPolicy",
                env,
                learning_rate=config.learning_rate,
                gamma=config.discount,
                tau=config.tau,
                buffer_size=config.buffer,
                replay_buffer_class=HerReplayBuffer,
                replay_buffer_kwargs={
                    "n_sampled_goal": config.relabelled_per_real,
                    "goal_selection_strategy": config.strategy,
                },
                policy_kwargs=networks(config.hidden, task),
                device="cpu",
            )

        def explore(action: Float32, rng: np.random.Generator) -> Float32:
            if rng.uniform() < config.random_share:
                return rng.uniform(-1.0, 1.0, action.shape).astype(np.float32)
            noise = rng.normal(scale=config.noise, size=action.shape)
            return np.clip(action + noise, -1.0, 1.0).astype(np.float32)

        super().__init__(build(make, task, seed), task, config.batch, explore)

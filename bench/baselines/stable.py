"""stable-baselines3's off-policy methods as controllers: the bench collects the episodes, its `train` learns.

Letters: S state, A action, G goal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor
from torch.optim import Optimizer

from bench.baselines import learned
from bench.baselines.controller import Float32, Trajectory, derived_seed
from bench.baselines.inputs import Inputs
from common.task import Task

Observation = dict[str, Float32]
Exploration = Callable[[Float32, np.random.Generator], Float32]

_END = {"TimeLimit.truncated": True}  # an episode ends by time alone, so its last value is bootstrapped


class GoalSpaces(gymnasium.Env[Observation, Float32]):
    """Spaces and rewards of a task, which is all that stable-baselines3 needs to be told; it never moves."""

    def __init__(self, task: Task) -> None:
        self._task = task
        sizes = {
            "observation": task.state_dim,
            "achieved_goal": task.goal_dim,
            "desired_goal": task.goal_dim,
        }
        self.observation_space: Any = spaces.Dict(
            [(name, spaces.Box(-np.inf, np.inf, (size,), np.float32)) for name, size in sizes.items()]
        )
        self.action_space = spaces.Box(-1.0, 1.0, (task.action_dim,), np.float32)

    def compute_reward(
        self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: object
    ) -> NDArray[Any]:
        """The environment's reward (N,) of attaining `achieved_goal` (N, G); `info` is not looked at."""
        del info
        return self._task.compute_reward(achieved_goal.astype(np.float64), desired_goal.astype(np.float64))


class Standardised(BaseFeaturesExtractor):
    """State and wanted goal as all compared networks see them; what is achieved is part of the state."""

    def __init__(self, observation_space: spaces.Dict, task: Task) -> None:
        super().__init__(observation_space, task.state_dim + task.goal_dim)
        self.inputs = Inputs(task)

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """(N, S + G)."""
        return self.inputs(observations["observation"], observations["desired_goal"])


class StableController:
    """A `Controller` around a model of stable-baselines3 that was made for `GoalSpaces`.

    `explore` changes a deterministic policy's action; None: the policy is stochastic itself.
    """

    def __init__(
        self, model: OffPolicyAlgorithm, task: Task, batch: int, explore: Exploration | None = None
    ) -> None:
        self._task = task
        self._batch = batch
        self._add_noise = explore
        # Actor, critic and entropy differ between its methods and stand in none of its types.
        self._model: Any = model
        self._model.set_logger(Logger(None, []))
        self.policy: Any = model.policy
        self._optimisers: dict[str, Optimizer] = {
            "actor": self.policy.actor.optimizer,
            "critic": self.policy.critic.optimizer,
        }
        if getattr(model, "ent_coef_optimizer", None) is not None:
            self._optimisers["entropy"] = self._model.ent_coef_optimizer
        self._exploring, self._seed, self._step = False, 0, 0

    def remember(self, trajectory: Trajectory) -> None:
        """Add the transitions one by one, as stable-baselines3 would have collected them."""
        last = len(trajectory.actions) - 1
        for t, (action, reward) in enumerate(zip(trajectory.actions, trajectory.rewards, strict=True)):
            self._model.replay_buffer.add(
                self._observation(trajectory.states[t], trajectory.goal),
                self._observation(trajectory.states[t + 1], trajectory.goal),
                action[None],
                np.array([reward]),
                np.array([t == last]),
                [_END if t == last else {}],
            )

    def learn(self, updates: int, seed: int) -> dict[str, float]:
        """Let the model's own `train` take the updates."""
        for module in self.policy.modules():
            if isinstance(module, Standardised):
                module.inputs.fit(self._states())
        with _seeded(seed):
            self._model.train(updates, self._batch)
        values = self._model.logger.name_to_value
        return {name.removeprefix("train/"): float(value) for name, value in values.items()}

    def begin(self, seed: int, explore: bool) -> None:
        """Remember how to draw this episode's noise."""
        self._exploring, self._seed, self._step = explore, seed, 0

    def act(self, state: Float32, goal: Float32) -> Float32:
        """The policy's action: drawn or noisy while exploring, else its mean."""
        seed = derived_seed(self._seed, self._step)
        self._step += 1
        observation = self._observation(state, goal)
        stochastic = self._exploring and self._add_noise is None
        with _seeded(seed):
            action = self._model.predict(observation, deterministic=not stochastic)[0][0]
        if self._exploring and self._add_noise is not None:
            action = self._add_noise(action, np.random.default_rng(seed))
        return action.astype(np.float32)

    def tensors(self) -> dict[str, Tensor]:
        """Networks, optimisers and SAC's entropy coefficient."""
        return learned.gather(self, self._optimisers) | {
            name: t.clone() for name, t in self._entropy().items()
        }

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Continue where `tensors` was taken."""
        learned.spread(tensors, self, self._optimisers)
        for name, tensor in self._entropy().items():
            tensor.copy_(tensors[name])

    def _entropy(self) -> dict[str, Tensor]:
        coefficient = getattr(self._model, "log_ent_coef", None)
        return {} if coefficient is None else {"log_entropy": coefficient.detach()}

    def _observation(self, state: Float32, goal: Float32) -> Observation:
        achieved = self._task.achieved(state)
        return {"observation": state[None], "achieved_goal": achieved[None], "desired_goal": goal[None]}

    def _states(self) -> Tensor:
        buffer = self._model.replay_buffer
        return torch.as_tensor(buffer.observations["observation"][: buffer.size(), 0])


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Lend stable-baselines3, which draws from the global generators, generators of a given seed."""
    before = np.random.get_state()  # noqa: NPY002 - what the library draws from
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        np.random.seed(seed)  # noqa: NPY002 - the same
        try:
            yield
        finally:
            np.random.set_state(before)  # noqa: NPY002 - the same


def networks(hidden: Sequence[int], task: Task) -> dict[str, Any]:
    """The library's options for networks of `hidden` units over standardised states and goals."""
    return {
        "net_arch": list(hidden),
        "features_extractor_class": Standardised,
        "features_extractor_kwargs": {"task": task},
    }


def build(make: Callable[[GoalSpaces], OffPolicyAlgorithm], task: Task, seed: int) -> OffPolicyAlgorithm:
    """Make a model whose first weights depend on `seed` alone."""
    with _seeded(seed):
        return make(GoalSpaces(task))

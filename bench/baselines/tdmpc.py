"""TD-MPC: MPPI in a learned latent model, with a learned policy as prior and a learned value at the end.

Hansen, Wang, Su: "Temporal Difference Learning for Model Predictive Control", ICML 2022; losses and updates
agree with the authors' code (github.com/nicklashansen/tdmpc, MIT licence; `python -m bench.parity` compares
the two). Defaults are those of its `cfgs/default.yaml` for states, but the batch.

Deviations:
* The observation is (state, goal), standardised by the warm-up; theirs is a raw state.
* The seed phase is the bench's warm-up: 5000 steps, then as many updates, the numbers that are theirs too.
* Batch 256 in place of 512, for the sake of a processor without accelerator.
* A candidate whose value is not finite scores -inf; theirs 0, the best of all where rewards are negative.
* Windows end with the episode; theirs leave out its last step. All chance comes from the bench's seeds.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812 - the field's name for it
from torch import Generator, Tensor, nn

from bench.baselines import learned
from bench.baselines.controller import Float32, Trajectory
from bench.baselines.inputs import Inputs
from bench.baselines.replay import Priorities, Replay
from common.config import Frozen
from common.task import Task


class Config(Frozen):
    """Table 5 of the paper."""

    discount: float = 0.99
    # planning
    iterations: int = 6
    samples: int = 512
    elites: int = 64
    policy_share: float = 0.05  # of the samples, added to them
    min_std: float = 0.05
    temperature: float = 0.5
    momentum: float = 0.1
    # learning
    batch: int = 256
    horizon: int = 5
    reward_weight: float = 0.5
    value_weight: float = 0.1
    consistency_weight: float = 2.0
    rho: float = 0.5  # weight of a step relative to the one before
    learning_rate: float = 1e-3
    first_std: float = 0.5  # falls to min_std, and the planning horizon grows from 1,
    schedule_steps: int = 25_000  # within these steps
    per_alpha: float = 0.6
    per_beta: float = 0.4
    gradient_norm: float = 10.0
    target_every: int = 2
    tau: float = 0.01
    encoder: int = 256  # width of its hidden layer
    hidden: int = 512
    latent: int = 50


class Batch(NamedTuple):
    """N windows of H steps."""

    observation: Tensor  # (H + 1, N, O)
    action: Tensor  # (H, N, A)
    reward: Tensor  # (H, N, 1)


class Losses(NamedTuple):
    """Sums over the H steps, each (N, 1), and the latent states."""

    consistency: Tensor
    reward: Tensor
    value: Tensor
    priority: Tensor
    latents: Tensor  # (H + 1, N, latent)


# --- the method: task-oriented latent dynamics (Sec. 4.1) -----------------------------------------------


class Told(nn.Module):
    """Encoder h, latent dynamics d, reward R, policy π and two values Q."""

    def __init__(self, observation: int, action: int, config: Config) -> None:
        super().__init__()
        z, wide = config.latent, config.hidden
        self.h = nn.Sequential(nn.Linear(observation, config.encoder), nn.ELU(), nn.Linear(config.encoder, z))
        self.d = _mlp(z + action, wide, z)
        self.reward = _mlp(z + action, wide, 1)
        self.pi = _mlp(z, wide, action)
        self.q = nn.ModuleList(_value(z + action, wide) for _ in range(2))
        for linear in (module for module in self.modules() if isinstance(module, nn.Linear)):
            nn.init.orthogonal_(linear.weight)
            nn.init.zeros_(linear.bias)
            if linear.out_features == 1:  # rewards and values begin at zero
                nn.init.zeros_(linear.weight)

    def next(self, z: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Latent state and reward (…, 1) one step on."""
        both = torch.cat((z, action), -1)
        return self.d(both), self.reward(both)

    def policy(self, z: Tensor, std: float, generator: Generator) -> Tensor:
        """π(z) with Gaussian noise cut at ±0.3; the gradient passes as if nothing were cut at ±1."""
        mean = torch.tanh(self.pi(z))
        action = mean + (std * torch.randn(mean.shape, generator=generator)).clamp(-0.3, 0.3)
        return action + (action.clamp(-1 + 1e-6, 1 - 1e-6) - action).detach()

    def values(self, z: Tensor, action: Tensor) -> Tensor:
        """Both Q (2, …, 1)."""
        both = torch.cat((z, action), -1)
        return torch.stack([q(both) for q in self.q])


def _mlp(inside: int, wide: int, out: int) -> nn.Sequential:
    first, second = nn.Linear(inside, wide), nn.Linear(wide, wide)
    return nn.Sequential(first, nn.ELU(), second, nn.ELU(), nn.Linear(wide, out))


def _value(inside: int, wide: int) -> nn.Sequential:
    first = (nn.Linear(inside, wide), nn.LayerNorm(wide), nn.Tanh())
    return nn.Sequential(*first, nn.Linear(wide, wide), nn.ELU(), nn.Linear(wide, 1))


# --- the method: losses (Eq. 7 to 11, Algorithm 2) ------------------------------------------------------


@torch.no_grad()
def value_target(slow: Told, z: Tensor, action: Tensor, reward: Tensor, discount: float) -> Tensor:
    """r + γ·min Q⁻(z', a') (…, 1) with the slow network's values of the latent state after the step."""
    return reward + discount * slow.values(z, action).amin(0)


def model_losses(model: Told, slow: Told, batch: Batch, config: Config, generator: Generator) -> Losses:
    """Unroll the latent model from the first observation; weigh step t by ρ^t."""
    with torch.no_grad():
        wanted_z, then = slow.h(batch.observation[1:]), model.h(batch.observation[1:])
        action = model.policy(then, config.min_std, generator)
    wanted_q = value_target(slow, then, action, batch.reward, config.discount)
    z = model.h(batch.observation[0])
    latents, sums = [z.detach()], [torch.zeros_like(batch.reward[0]) for _ in range(4)]
    for t, action in enumerate(batch.action):
        q = model.values(z, action)
        z, reward = model.next(z, action)
        terms = (
            F.mse_loss(z, wanted_z[t], reduction="none").mean(1, keepdim=True),
            (reward - batch.reward[t]) ** 2,
            ((q - wanted_q[t]) ** 2).sum(0),
            (q.detach() - wanted_q[t]).abs().sum(0),
        )
        sums = [total + config.rho**t * term for total, term in zip(sums, terms, strict=True)]
        latents.append(z.detach())
    return Losses(sums[0], sums[1], sums[2], sums[3], torch.stack(latents))


def policy_loss(model: Told, latents: Tensor, config: Config, generator: Generator) -> Tensor:
    """-min Q(z, π(z)) along the unrolled latents (H + 1, N, latent), Eq. (11)."""
    action = model.policy(latents, config.min_std, generator)
    value = model.values(latents, action).amin(0).mean((1, 2))
    return -(value * config.rho ** torch.arange(len(value))).sum()


# --- the method: planning (Algorithm 1) and learning ----------------------------------------------------


class Agent:
    """A `Controller`."""

    def __init__(self, config: Config, task: Task, seed: int) -> None:
        self._config = config
        self.inputs = Inputs(task)
        self._replay = Replay(task, config.horizon)
        self._priorities = Priorities()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.model = Told(self.inputs.width, task.action_dim, config)
        self.slow = copy.deepcopy(self.model).requires_grad_(False)
        self._policy = list(self.model.pi.parameters())
        self._rest = [each for name, each in self.model.named_parameters() if not name.startswith("pi.")]
        self._optimisers = {
            "model": torch.optim.Adam(self._rest, lr=config.learning_rate),
            "policy": torch.optim.Adam(self._policy, lr=config.learning_rate),
        }
        self.steps = self.updates = 0
        self._plan = torch.zeros(1, task.action_dim)  # the mean of the last plan
        self._explore, self._noise = False, Generator()

    @torch.no_grad()
    def act(self, state: Float32, goal: Float32) -> Float32:
        """MPPI around the last plan, shifted by a step; executes the first action of one of the elites."""
        config, noise = self._config, self._noise
        progress = min(1.0, self.steps / config.schedule_steps)
        horizon = int(1 + (config.horizon - 1) * progress)
        least = config.first_std + (config.min_std - config.first_std) * progress
        z = self.model.h(self.inputs(torch.as_tensor(state), torch.as_tensor(goal))[None])
        prior = self._prior(z, horizon)
        z = z.expand(config.samples + prior.shape[1], -1)
        mean, std = (torch.full((horizon, self._plan.shape[1]), value) for value in (0.0, 2.0))
        mean[: len(self._plan) - 1] = self._plan[1:horizon]
        elites, score = prior, torch.ones(prior.shape[1])
        for _ in range(config.iterations):
            drawn = torch.randn(horizon, config.samples, mean.shape[1], generator=noise)
            actions = torch.cat(((mean[:, None] + std[:, None] * drawn).clamp(-1, 1), prior), 1)
            value, best = self._estimate(z, actions).topk(config.elites)
            elites = actions[:, best]
            score = torch.softmax(config.temperature * value, 0).nan_to_num(1 / config.elites)
            new_mean = (score[:, None] * elites).sum(1)
            std = (score[:, None] * (elites - new_mean[:, None]) ** 2).sum(1).sqrt().clamp(least, 2.0)
            mean = config.momentum * mean + (1 - config.momentum) * new_mean
        self._plan = mean
        action = elites[0, torch.multinomial(score, 1, generator=noise)[0]]
        if self._explore:
            action = action + std[0] * torch.randn(mean.shape[1], generator=noise)
        return action.clamp(-1, 1).numpy()

    def _prior(self, z: Tensor, horizon: int) -> Tensor:
        """Action sequences (horizon, n, A) that the policy draws from the latent state z (1, latent)."""
        z, actions = z.expand(int(self._config.policy_share * self._config.samples), -1), []
        for _ in range(horizon):
            actions.append(self.model.policy(z, self._config.min_std, self._noise))
            z, _ = self.model.next(z, actions[-1])
        return torch.stack(actions)

    def _estimate(self, z: Tensor, actions: Tensor) -> Tensor:
        """Discounted rewards of sequences (horizon, n, A) and the value at their end, (n,)."""
        total, discount = torch.zeros(len(z), 1), 1.0
        for action in actions:
            z, reward = self.model.next(z, action)
            total, discount = total + discount * reward, discount * self._config.discount
        end = self.model.policy(z, self._config.min_std, self._noise)
        total = (total + discount * self.model.values(z, end).amin(0))[:, 0]
        return torch.where(total.isfinite(), total, -torch.inf)

    def learn(self, updates: int, seed: int) -> dict[str, float]:
        """Draw windows by priority, update on them, and take their value errors as new priorities."""
        self.inputs.fit(self._replay.states)
        config, generator, losses = self._config, Generator().manual_seed(seed), {}
        for _ in range(updates):
            numbers = self._priorities.sample(config.batch, generator)
            chance = self._priorities.values / self._priorities.values.sum()
            weights = (len(chance) * chance[numbers]) ** -config.per_beta
            drawn = self._replay.windows(numbers)
            observation = self.inputs(drawn.states, drawn.goal.expand(len(drawn.states), -1, -1))
            batch = Batch(observation, drawn.actions, drawn.rewards)
            priority, losses = self.update(batch, weights / weights.max(), generator)
            self._priorities.update(numbers, (priority + 1e-6) ** config.per_alpha)
        self._priorities.forget_largest()
        return losses

    def update(self, batch: Batch, weights: Tensor, generator: Generator) -> tuple[Tensor, dict[str, float]]:
        """One update of everything; returns new priorities (N,) before the power, and the losses."""
        config = self._config
        parts = model_losses(self.model, self.slow, batch, config, generator)
        each = config.consistency_weight * parts.consistency.clamp_max(1e4)
        each = each + config.reward_weight * parts.reward.clamp_max(1e4)
        each = each + config.value_weight * parts.value.clamp_max(1e4)
        self._step("model", (each[:, 0] * weights).mean() / config.horizon, self._rest)
        pi_loss = policy_loss(self.model, parts.latents, config, generator)
        self._step("policy", pi_loss, self._policy)
        if self.updates % config.target_every == 0:
            for slow, fast in zip(self.slow.parameters(), self.model.parameters(), strict=True):
                slow.lerp_(fast.detach(), config.tau)
        self.updates += 1
        losses = {name: float(getattr(parts, name).mean()) for name in ("consistency", "reward", "value")}
        return parts.priority[:, 0].clamp_max(1e4), losses | {"policy": float(pi_loss)}

    def _step(self, name: str, loss: Tensor, parameters: list[nn.Parameter]) -> None:
        self._optimisers[name].zero_grad()
        loss.backward(inputs=parameters)
        nn.utils.clip_grad_norm_(parameters, self._config.gradient_norm)
        self._optimisers[name].step()

    # --- surroundings -----------------------------------------------------------------------------------

    def remember(self, trajectory: Trajectory) -> None:
        """Store an episode."""
        self._priorities.add(self._replay.add(trajectory))
        self.steps += len(trajectory.actions)

    def begin(self, seed: int, explore: bool) -> None:
        """Forget the last episode's plan."""
        self._plan = self._plan[:1]
        self._explore, self._noise = explore, Generator().manual_seed(seed)

    def tensors(self) -> dict[str, Tensor]:
        """Networks, optimisers and priorities."""
        counts = {"updates": torch.tensor(self.updates), "priorities": self._priorities.values.clone()}
        return learned.gather(self, self._optimisers) | counts

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Continue where `tensors` was taken."""
        learned.spread(tensors, self, self._optimisers)
        self.updates = int(tensors["updates"])
        self._priorities.values = tensors["priorities"].clone()
        self._priorities.forget_largest()

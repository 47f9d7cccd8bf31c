"""TD7: TD3 with learned state-action embeddings (SALE), prioritised replay (LAP) and policy checkpoints.

Fujimoto, Chang, Smith, Gu, Precup, Meger: "For SALE: State-Action Representation Learning for Deep
Reinforcement Learning", NeurIPS 2023; losses and updates agree with the authors' code (github.com/sfujim/TD7,
MIT licence; `python -m bench.parity` compares the two). Every default below is theirs.

Deviations:
* The observation is (state, goal), standardised by the warm-up; theirs is a raw state.
* 5000 warm-up steps of the bench, and as many updates before the first own episode, in place of 25 000 random
  steps and none: with those it would not have begun to learn within the compared budgets.
* A policy becomes the checkpoint by one episode's return, which is theirs before 750 000 updates; assessment
  over 20 episodes after that is left out, since no run here gets there. As goals are random here, a return
  also depends on the luck of its goal: `checkpoints: false` evaluates the newest policy instead.
* Episodes end by time alone, so there is no terminal mask. Offline training is left out.
* All chance comes from the generators that the bench seeds.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import NamedTuple, TypeVar

import torch
import torch.nn.functional as F  # noqa: N812 - the field's name for it
from torch import Generator, Tensor, nn

from bench.baselines import learned
from bench.baselines.controller import Float32, Trajectory
from bench.baselines.inputs import Inputs
from bench.baselines.replay import Priorities, Replay
from common.config import Frozen
from common.task import Task

ModuleT = TypeVar("ModuleT", bound=nn.Module)


class Config(Frozen):
    """Table 3 of the paper."""

    batch: int = 256
    discount: float = 0.99
    target_update_every: int = 250
    exploration_noise: float = 0.1
    target_policy_noise: float = 0.2  # TD3's
    noise_clip: float = 0.5
    policy_every: int = 2
    lap_alpha: float = 0.4
    lap_least: float = 1.0  # smallest priority before the power
    checkpoints: bool = True
    embedding: int = 256
    hidden: int = 256
    learning_rate: float = 3e-4


class Batch(NamedTuple):
    """N transitions; observations (N, O), action (N, A), reward (N, 1)."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor


# --- the method: SALE (Sec. 4) ------------------------------------------------------------------------


def average_l1_norm(x: Tensor) -> Tensor:
    """Scale (…, D) so that the mean of |x| over D is 1."""
    return x / x.abs().mean(-1, keepdim=True).clamp_min(1e-8)


class Encoder(nn.Module):
    """z^s = f(s), and z^sa = g(z^s, a), which is trained to be the next state's z^s."""

    def __init__(self, observation: int, action: int, config: Config) -> None:
        super().__init__()
        wide, out = config.hidden, config.embedding
        self.f = _mlp(observation, wide, out, nn.ELU)
        self.g = _mlp(out + action, wide, out, nn.ELU)

    def state(self, observation: Tensor) -> Tensor:
        """z^s, (N, embedding)."""
        return average_l1_norm(self.f(observation))

    def pair(self, zs: Tensor, action: Tensor) -> Tensor:
        """z^sa, (N, embedding)."""
        return self.g(torch.cat((zs, action), 1))


class Embedded(nn.Module):
    """A network that sees its input, scaled by AvgL1Norm, beside embeddings of it."""

    def __init__(
        self, inside: int, embeddings: int, out: int, wide: int, activation: type[nn.Module]
    ) -> None:
        super().__init__()
        self.first = nn.Linear(inside, wide)
        self.rest = _mlp(embeddings + wide, wide, out, activation)

    def forward(self, x: Tensor, embeddings: Tensor) -> Tensor:
        """(N, inside) and (N, embeddings) → (N, out)."""
        return self.rest(torch.cat((average_l1_norm(self.first(x)), embeddings), 1))


class Actor(Embedded):
    """π(s, z^s), an action in [-1, 1]."""

    def __init__(self, observation: int, action: int, config: Config) -> None:
        super().__init__(observation, config.embedding, action, config.hidden, nn.ReLU)

    def forward(self, x: Tensor, embeddings: Tensor) -> Tensor:
        """(N, A)."""
        return super().forward(x, embeddings).tanh()


class Critic(nn.Module):
    """Q1 and Q2 of (s, a, z^sa, z^s)."""

    def __init__(self, observation: int, action: int, config: Config) -> None:
        super().__init__()
        sizes = (observation + action, 2 * config.embedding, 1, config.hidden, nn.ELU)
        self.values = nn.ModuleList(Embedded(*sizes) for _ in range(2))

    def forward(self, observation: Tensor, action: Tensor, zsa: Tensor, zs: Tensor) -> Tensor:
        """(N, 2)."""
        pair, embeddings = torch.cat((observation, action), 1), torch.cat((zsa, zs), 1)
        return torch.cat([value(pair, embeddings) for value in self.values], 1)


def _mlp(inside: int, wide: int, out: int, activation: type[nn.Module]) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inside, wide), activation(), nn.Linear(wide, wide), activation(), nn.Linear(wide, out)
    )


# --- the method: loss-adjusted prioritised replay (Fujimoto et al. 2020) --------------------------------


def lap_huber(error: Tensor) -> Tensor:
    """Huber loss of |error| (N, 2), summed over both Qs: with LAP's priorities it is unbiased."""
    return torch.where(error < 1.0, 0.5 * error**2, error).sum(1).mean()


def lap_priority(error: Tensor, alpha: float, least: float) -> Tensor:
    """max(|error|, least)^alpha (N,) of the worse Q in `error` (N, 2): small errors are drawn uniformly."""
    return error.max(1).values.clamp_min(least) ** alpha


# --- the method: TD3 on top of both (Algorithm 1) -------------------------------------------------------


class Agent:
    """A `Controller`."""

    def __init__(self, config: Config, task: Task, seed: int) -> None:
        self._config = config
        self.inputs = Inputs(task)
        self._replay = Replay(task, steps=1)
        self._priorities = Priorities()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            sizes = (self.inputs.width, task.action_dim, config)
            self.actor, self.critic, self.encoder = Actor(*sizes), Critic(*sizes), Encoder(*sizes)
        self.actor_target, self.critic_target = _copy(self.actor), _copy(self.critic)
        self.fixed_encoder, self.fixed_encoder_target = _copy(self.encoder), _copy(self.encoder)
        self.checkpoint_actor, self.checkpoint_encoder = _copy(self.actor), _copy(self.encoder)
        self._optimisers = {
            name: torch.optim.Adam(getattr(self, name).parameters(), lr=config.learning_rate)
            for name in ("actor", "critic", "encoder")
        }
        self.updates = 0
        self._seen = (float("inf"), -float("inf"))  # targets of Q so far: smallest, largest
        self._range = (0.0, 0.0)  # and those that bound the next ones
        self.best_return = -float("inf")  # the checkpoint's
        self._explore, self._noise = False, Generator()

    def learn(self, updates: int, seed: int) -> dict[str, float]:
        """Draw batches by priority, update on them, and tell LAP how wrong the critic was."""
        self.inputs.fit(self._replay.states)
        config, generator, losses = self._config, Generator().manual_seed(seed), {}
        for _ in range(updates):
            numbers = self._priorities.sample(config.batch, generator)
            batch = self._batch(numbers)
            noise = torch.randn(batch.action.shape, generator=generator)
            error, losses = self.update(batch, noise)
            self._priorities.update(numbers, lap_priority(error, config.lap_alpha, config.lap_least))
            if self.updates % config.target_update_every == 0:
                self._priorities.forget_largest()
        return losses

    def update(self, batch: Batch, noise: Tensor) -> tuple[Tensor, dict[str, float]]:
        """One update of everything, `noise` (N, A) standard normal; returns |error| (N, 2) and the losses."""
        self.updates += 1
        encoder_loss = self._step("encoder", self._encoder_loss(batch))
        target = self._value_target(batch, noise)
        with torch.no_grad():
            zs = self.fixed_encoder.state(batch.observation)
            zsa = self.fixed_encoder.pair(zs, batch.action)
        error = (self.critic(batch.observation, batch.action, zsa, zs) - target).abs()
        losses = {"encoder": encoder_loss, "critic": self._step("critic", lap_huber(error))}
        if self.updates % self._config.policy_every == 0:
            losses["actor"] = self._step("actor", self._actor_loss(batch, zs))
        if self.updates % self._config.target_update_every == 0:
            self._update_targets()
        return error.detach(), losses

    def _encoder_loss(self, batch: Batch) -> Tensor:
        """SALE: the embedding of state and action predicts that of the next state."""
        with torch.no_grad():
            next_zs = self.encoder.state(batch.next_observation)
        return F.mse_loss(self.encoder.pair(self.encoder.state(batch.observation), batch.action), next_zs)

    @torch.no_grad()
    def _value_target(self, batch: Batch, noise: Tensor) -> Tensor:
        """(N, 1): TD3's smoothed, clipped double Q, kept within the range of targets seen before."""
        config, then = self._config, batch.next_observation
        zs = self.fixed_encoder_target.state(then)
        noise = (noise * config.target_policy_noise).clamp(-config.noise_clip, config.noise_clip)
        action = (self.actor_target(then, zs) + noise).clamp(-1, 1)
        zsa = self.fixed_encoder_target.pair(zs, action)
        value = self.critic_target(then, action, zsa, zs).min(1, keepdim=True).values
        target = batch.reward + config.discount * value.clamp(*self._range)
        smallest, largest = self._seen
        self._seen = (min(smallest, float(target.min())), max(largest, float(target.max())))
        return target

    def _actor_loss(self, batch: Batch, zs: Tensor) -> Tensor:
        action = self.actor(batch.observation, zs)
        return -self.critic(batch.observation, action, self.fixed_encoder.pair(zs, action), zs).mean()

    def _update_targets(self) -> None:
        self.actor_target.load_state_dict(self.actor.state_dict())
        self.critic_target.load_state_dict(self.critic.state_dict())
        self.fixed_encoder_target.load_state_dict(self.fixed_encoder.state_dict())
        self.fixed_encoder.load_state_dict(self.encoder.state_dict())
        self._range = self._seen

    def _step(self, name: str, loss: Tensor) -> float:
        optimiser = self._optimisers[name]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        return float(loss.detach())

    def remember(self, trajectory: Trajectory) -> None:
        """Store an episode; a policy that did better in it than the checkpoint becomes the checkpoint."""
        self._priorities.add(self._replay.add(trajectory))
        earned = float(trajectory.rewards.sum())
        if trajectory.planned and earned >= self.best_return:
            self.best_return = earned
            self.checkpoint_actor.load_state_dict(self.actor.state_dict())
            self.checkpoint_encoder.load_state_dict(self.fixed_encoder.state_dict())

    def begin(self, seed: int, explore: bool) -> None:
        """Explore with the newest policy, evaluate with the checkpoint."""
        self._explore, self._noise = explore, Generator().manual_seed(seed)

    @torch.no_grad()
    def act(self, state: Float32, goal: Float32) -> Float32:
        """π and, if exploring, Gaussian noise."""
        observation = self.inputs(torch.as_tensor(state), torch.as_tensor(goal))[None]
        if not self._explore and self._config.checkpoints:
            action = self.checkpoint_actor(observation, self.checkpoint_encoder.state(observation))
        else:
            action = self.actor(observation, self.fixed_encoder.state(observation))
        if self._explore:
            drawn = torch.randn(action.shape, generator=self._noise)
            action = action + self._config.exploration_noise * drawn
        return action.clamp(-1, 1)[0].numpy()

    # --- surroundings: batches and what is kept ---------------------------------------------------------

    def _batch(self, numbers: Tensor) -> Batch:
        drawn = self._replay.windows(numbers)
        now, then = (self.inputs(states, drawn.goal) for states in drawn.states)
        return Batch(now, drawn.actions[0], drawn.rewards[0], then)

    def tensors(self) -> dict[str, Tensor]:
        """Networks, optimisers, priorities, value range and the checkpoint's return."""
        numbers = [self.updates, self.best_return, self._priorities.largest, *self._seen, *self._range]
        return {
            **learned.gather(self, self._optimisers),
            "priorities": self._priorities.values.clone(),
            "numbers": torch.tensor(numbers, dtype=torch.float64),
        }

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Continue where `tensors` was taken."""
        learned.spread(tensors, self, self._optimisers)
        self._priorities.values = tensors["priorities"].clone()
        updates, self.best_return, self._priorities.largest, *bounds = tensors["numbers"].tolist()
        self.updates, self._seen, self._range = int(updates), (bounds[0], bounds[1]), (bounds[2], bounds[3])


def _copy(module: ModuleT) -> ModuleT:
    return copy.deepcopy(module).requires_grad_(False)

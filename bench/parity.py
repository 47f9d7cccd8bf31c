"""Our TD7 and TD-MPC beside their authors' code: same weights and batches, losses and weights compared.

    python -m bench.parity --td7 DIR --tdmpc DIR

DIR is a checkout of github.com/sfujim/TD7 or github.com/nicklashansen/tdmpc; neither is part of this project.
Noise is switched off on both sides, for each draws its own. Prints the largest differences, as JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from torch import Generator, Tensor, nn

from bench.baselines import td7, tdmpc
from bench.provenance import provenance
from common.task import get_task

TASK = "reach"
UPDATES = 300  # beyond the first update of TD7's targets, after 250
BATCH = 256


class _Batches:
    """Stands for a replay buffer: hands out the batch that it was given, and takes priorities."""

    def __init__(self) -> None:
        self.batch: tuple[Tensor, ...] = ()
        self.priority = torch.zeros(0)

    def sample(self) -> tuple[Tensor, ...]:
        return self.batch

    def update_priority(self, priority: Tensor) -> None:
        self.priority = priority

    def update_priorities(self, numbers: Tensor, priority: Tensor) -> None:
        del numbers
        self.priority = priority

    def reset_max_priority(self) -> None:
        pass


def compare_td7(directory: Path) -> dict[str, float]:
    """Largest differences after UPDATES updates: weights of each network, LAP priorities, range of Q."""
    theirs_module = _load(directory, "TD7")
    task, config = get_task(TASK), td7.Config(target_policy_noise=0.0)
    ours = td7.Agent(config, task, seed=0)
    hp = theirs_module.Hyperparameters(target_policy_noise=0.0, buffer_size=1)
    theirs = theirs_module.Agent(ours.inputs.width, task.action_dim, 1, hp=hp)
    names = ("actor", "critic", "encoder", "actor_target", "critic_target")
    names = (*names, "fixed_encoder", "fixed_encoder_target")
    for name in names:
        _copy(getattr(ours, name), getattr(theirs, name))
    theirs.replay_buffer = replay = _Batches()
    generator, priority = Generator().manual_seed(1), 0.0
    for _ in range(UPDATES):
        batch = _transitions(ours.inputs.width, task.action_dim, generator)
        now, action, reward, then = batch
        replay.batch = (now, action, then, reward, torch.ones_like(reward))
        theirs.train()
        error, _ = ours.update(batch, torch.zeros_like(action))
        own = td7.lap_priority(error, config.lap_alpha, config.lap_least)
        priority = max(priority, _largest([own], [replay.priority]))
    found = {name: _difference(getattr(ours, name), getattr(theirs, name)) for name in names}
    return {"priority": priority, **found}


def compare_tdmpc(directory: Path) -> dict[str, float]:
    """Largest differences over UPDATES updates: each loss, priorities; and of the weights at their end."""
    nn.Module.cuda = lambda self, device=None: self  # their code has the device written into it
    theirs_module = _load(directory / "src", "algorithm.tdmpc")
    task, config = get_task(TASK), tdmpc.Config(min_std=0.0)
    ours = tdmpc.Agent(config, task, seed=0)
    theirs = theirs_module.TDMPC(_tdmpc_settings(config, ours.inputs.width, task.action_dim))
    for mine, other in ((ours.model, theirs.model), (ours.slow, theirs.model_target)):
        _copy(mine, other)
    replay, generator = _Batches(), Generator().manual_seed(1)
    found: dict[str, float] = dict.fromkeys(("consistency", "reward", "value", "policy", "priority"), 0.0)
    for step in range(UPDATES):
        batch, weights = _windows(config, ours.inputs.width, task.action_dim, generator)
        nothing = torch.zeros(BATCH, dtype=torch.int64)
        replay.batch = (
            batch.observation[0],
            batch.observation[1:],
            batch.action,
            batch.reward,
            nothing,
            weights,
        )
        losses = theirs.update(replay, step)
        priority, own = ours.update(batch, weights, generator)
        pairs = {name: (own[name], losses[f"{'pi' if name == 'policy' else name}_loss"]) for name in own}
        for name, (mine, other) in pairs.items():
            found[name] = max(found[name], abs(mine - other))
        found["priority"] = max(found["priority"], _largest([priority], [replay.priority[:, 0]]))
    found["weights"] = _difference(ours.model, theirs.model)
    return found | {"slow_weights": _difference(ours.slow, theirs.model_target)}


def _tdmpc_settings(config: tdmpc.Config, observation: int, action: int) -> SimpleNamespace:
    """Their configuration with our values."""
    return SimpleNamespace(
        modality="state",
        obs_shape=(observation,),
        action_dim=action,
        enc_dim=config.encoder,
        mlp_dim=config.hidden,
        latent_dim=config.latent,
        lr=config.learning_rate,
        std_schedule="0.5",
        min_std=config.min_std,
        discount=config.discount,
        horizon=config.horizon,
        rho=config.rho,
        consistency_coef=config.consistency_weight,
        reward_coef=config.reward_weight,
        value_coef=config.value_weight,
        grad_clip_norm=config.gradient_norm,
        update_freq=config.target_every,
        tau=config.tau,
    )


def _transitions(observation: int, action: int, generator: Generator) -> td7.Batch:
    def draw(width: int) -> Tensor:
        return torch.randn(BATCH, width, generator=generator)

    return td7.Batch(draw(observation), draw(action).clamp(-1, 1), -draw(1).abs(), draw(observation))


def _windows(
    config: tdmpc.Config, observation: int, action: int, generator: Generator
) -> tuple[tdmpc.Batch, Tensor]:
    def draw(steps: int, width: int) -> Tensor:
        return torch.randn(steps, BATCH, width, generator=generator)

    steps = config.horizon
    batch = tdmpc.Batch(draw(steps + 1, observation), draw(steps, action).clamp(-1, 1), -draw(steps, 1).abs())
    return batch, torch.rand(BATCH, generator=generator)


def _load(directory: Path, name: str) -> Any:
    sys.path.insert(0, str(directory))
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        sys.exit(f"bench.parity: {directory}: no such checkout ({error})")


def _copy(source: nn.Module, into: nn.Module) -> None:
    with torch.no_grad():
        for mine, other in zip(source.parameters(), into.parameters(), strict=True):
            other.copy_(mine)


def _difference(ours: nn.Module, theirs: nn.Module) -> float:
    return _largest(ours.parameters(), theirs.parameters())


def _largest(ours: Iterable[Tensor], theirs: Iterable[Tensor]) -> float:
    return max(float((a - b).abs().max()) for a, b in zip(ours, theirs, strict=True))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.parity", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--td7", type=Path, metavar="DIR")
    parser.add_argument("--tdmpc", type=Path, metavar="DIR")
    parser.add_argument("--json", action="store_true", help="as every bench; there is no other form")
    arguments = parser.parse_args()
    found: dict[str, Mapping[str, Any]] = {}
    if arguments.td7:
        found["td7"] = compare_td7(arguments.td7)
    if arguments.tdmpc:
        found["tdmpc"] = compare_tdmpc(arguments.tdmpc)
    print(json.dumps({"updates": UPDATES, "batch": BATCH, **found, **provenance()}))


if __name__ == "__main__":
    main()

"""Trains the ensemble in slices; deterministic for a seed, and resumable to the bit.

Letters: B members, N windows, S state, A action.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from common.model.choose import StateLayout, coordinates_of
from common.model.config import ModelConfig
from common.model.coordinates import Coordinates
from common.model.dynamics import Dynamics
from common.model.ensemble import Ensemble
from common.model.masks import MaskPool, Masks
from common.model.normaliser import Normaliser
from common.model.sealed import SealError, seal, unseal
from common.model.snapshot import Snapshot, SnapshotMeta
from common.storage import write_atomically
from services.learner.backprop import TrainedEnsemble
from services.learner.config import LearnerConfig
from services.learner.evaluation import ModelErrors, evaluate
from services.learner.loss import LossTerms, loss_terms, weight_decay
from services.learner.replay import Replay, Windows


class TrainerStateRefused(Exception):  # noqa: N818 - reads as what happened
    """A saved state that does not belong to this trainer; the message is one line."""


@dataclass(frozen=True)
class SliceMetrics:
    """Means over the gradient steps of one slice."""

    updates: int  # gradient steps done in the slice
    skipped: int  # of them, steps not taken because the gradient was not finite
    learning_rate: float  # of the last step
    gradient_norm: float  # before clipping, of the steps taken
    loss: dict[str, float]  # each term of Eq. (4); weight decay as it is at the end


class Trainer:
    """Owns weights, optimiser and random state; `begin` opens an update, `train_slice` works it off."""

    def __init__(
        self, config: LearnerConfig, model: ModelConfig, layout: StateLayout, seed: int, device: str = "cpu"
    ) -> None:
        if len(config.loss.decay) != len(model.hidden) + 1:
            raise ValueError(f"loss.decay needs {len(model.hidden) + 1} rates, one a layer")
        self.config, self.model, self.layout = config, model, layout
        self.updates = 0  # gradient steps in this trainer's life
        self.remaining = 0  # gradient steps left of the update that `begin` opened
        self._planned = 0
        self._snapshots = 0
        self._fitted = False
        self._seed, self._device = seed, device
        self._generator = torch.Generator().manual_seed(seed)
        self._train_masks = self._draw_masks(model.train_masks).to(device)
        self.plan_masks = self._draw_masks(model.plan_masks).to(device)
        coordinates = coordinates_of(model.coordinates, layout)
        identity = Normaliser.identity(coordinates.inputs, coordinates.changes)
        fresh = Dynamics.create(model, identity, coordinates, self._generator)
        self._ensemble = TrainedEnsemble.like(fresh.ensemble)
        self.dynamics = replace(fresh, ensemble=self._ensemble).to(device)
        self._weights = _dimension_weights(config.loss.group_weights, layout, coordinates, device)
        self._optimiser = _adam(self._ensemble, config)

    def begin(self, replay: Replay, updates: int) -> None:
        """Open an update of `updates` gradient steps on what `replay` now holds, and refit the normaliser.

        Without a training window there is nothing to do, and nothing remains.
        """
        ready = replay.windows("train") > 0
        self._planned = self.remaining = updates if ready else 0
        if not ready or not self.model.normalise:
            return
        # Paper: Eq. (3) recalculates the statistics before each update; a frozen normaliser is the option.
        if self.config.normaliser_refit == "each_update" or not self._fitted:
            self._set_normaliser(replay.normaliser())
            self._fitted = True

    def train_slice(self, replay: Replay, updates: int | None = None) -> SliceMetrics:
        """Take at most `updates` (default `slice_updates`) of the remaining gradient steps."""
        wanted = self.config.slice_updates if updates is None else updates
        count = min(wanted, self.remaining)
        sums = torch.zeros(len(LossTerms._fields), device=self._device)
        norms, skipped, rate = 0.0, 0, 0.0
        for _ in range(count):
            rate = self._rate()
            terms, norm = self._step(replay, rate)
            sums += torch.stack(terms).detach()
            finite = math.isfinite(norm)
            norms += norm if finite else 0.0
            skipped += not finite
        loss = dict(zip(LossTerms._fields, (sums / max(1, count)).tolist(), strict=True))
        options = self.config.loss
        loss["weight_decay"] = weight_decay(self._ensemble, options.decay, options.decay_biases)
        return SliceMetrics(count, skipped, rate, norms / max(1, count - skipped), loss)

    def evaluate_holdout(self, replay: Replay) -> ModelErrors:
        """Errors and calibration per state group, each member with its first planning mask; or nothing."""
        masks = self.plan_masks.particles(1) if self.model.dropout > 0.0 else None
        return evaluate(self.dynamics, masks, replay, self.layout.groups)

    def snapshot(self, episodes: int) -> Snapshot:
        """An immutable copy of the model; `episodes` is how many it has seen."""
        meta = SnapshotMeta(
            task=self.layout.name,
            state_dim=self.layout.state_dim,
            action_dim=self.layout.action_dim,
            inputs=self.dynamics.coordinates.inputs,
            changes=self.dynamics.coordinates.changes,
            counter=self._snapshots,
            episodes=episodes,
            model=self.model,
        )
        self._snapshots += 1
        return Snapshot.of(self.dynamics, self.plan_masks, meta)

    def state_bytes(self) -> bytes:
        """Everything that training depends on beside the data, as one sealed safetensors file."""
        tensors = {f"parameter.{i}": parameter for i, parameter in enumerate(self._parameters)}
        for i, parameter in enumerate(self._parameters):
            moments = self._optimiser.state.get(parameter, {})
            tensors |= {f"adam.{i}.{name}": value for name, value in moments.items()}
        tensors |= self.dynamics.normaliser.tensors()
        tensors["generator"] = self._generator.get_state()
        counts = [self.updates, self.remaining, self._planned, self._snapshots, int(self._fitted)]
        tensors["counts"] = torch.tensor(counts)
        return seal(tensors, self._identity())

    def load_state_bytes(self, payload: bytes) -> None:
        """Continue where `state_bytes` was taken. Raises TrainerStateRefused, and changes nothing then."""
        try:
            tensors, identity = unseal(payload)
        except SealError as error:
            raise TrainerStateRefused(str(error)) from None
        if identity != self._identity():
            raise TrainerStateRefused("saved by another version, seed, task or model configuration")
        with torch.no_grad():
            for i, parameter in enumerate(self._parameters):
                parameter.copy_(tensors[f"parameter.{i}"])
                self._load_moments(parameter, f"adam.{i}.", tensors)
        names = Normaliser.identity(1, 1).tensors()
        self._set_normaliser(Normaliser(**{name: tensors[name] for name in names}))
        self._generator.set_state(tensors["generator"])
        counts = [int(count) for count in tensors["counts"]]
        self.updates, self.remaining, self._planned, self._snapshots, fitted = counts
        self._fitted = bool(fitted)

    def save(self, path: Path) -> None:
        """Write the state so that a crash leaves the old file or the new one, never half of it."""
        write_atomically(path, self.state_bytes())

    def load(self, path: Path) -> None:
        """Continue from a file that `save` wrote. Raises TrainerStateRefused or OSError."""
        self.load_state_bytes(path.read_bytes())

    @property
    def _parameters(self) -> list[torch.nn.Parameter]:
        return list(self.dynamics.ensemble.parameters())

    def _step(self, replay: Replay, rate: float) -> tuple[LossTerms, float]:
        """One gradient step on B independent batches; returns the terms and the norm of the gradient."""
        windows = self._windows(replay)
        masks = (self._pick_masks(), self._pick_masks())
        terms = loss_terms(self.dynamics, windows, masks, self.config.loss, self._weights)
        self._ensemble.start_gradient()
        terms.total.backward()
        norm = self._clip()
        if math.isfinite(norm):
            for group in self._optimiser.param_groups:
                group["lr"] = rate
            self._optimiser.step()
        self.updates += 1
        self.remaining -= 1
        return terms, norm

    def _clip(self) -> float:
        """Shorten the gradient of all members together to norm `clip`; returns the norm before."""
        gradients = [each.grad for each in self._parameters if each.grad is not None]
        norm = float(torch.nn.utils.get_total_norm(gradients))
        if math.isfinite(norm) and norm > self.config.clip:
            for gradient in gradients:
                gradient.mul_(self.config.clip / norm)
        return norm

    def _windows(self, replay: Replay) -> Windows:
        config = self.config
        drawn = replay.sample(
            self.model.members, config.batch, self._generator, config.recent_fraction, config.recent_episodes
        )
        return Windows(*(tensor.to(self._device) for tensor in drawn))

    def _pick_masks(self) -> Masks | None:
        if self.model.dropout == 0.0:
            return None
        return self._train_masks.pick(self.config.batch, self._generator)

    def _rate(self) -> float:
        first = self.updates + self.remaining == self._planned
        rate = self.config.learning_rate if first else self.config.later_learning_rate
        if self.config.schedule == "constant":
            return rate
        done = 1.0 - self.remaining / self._planned
        return rate * 0.5 * (1.0 + math.cos(math.pi * done))

    def _draw_masks(self, size: int) -> MaskPool:
        model = self.model
        return MaskPool.draw(model.members, size, model.hidden, model.dropout, self._generator)

    def _set_normaliser(self, normaliser: Normaliser) -> None:
        self.dynamics = replace(self.dynamics, normaliser=normaliser.to(self._device))

    def _load_moments(self, parameter: torch.nn.Parameter, prefix: str, tensors: dict[str, Tensor]) -> None:
        found = {
            name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)
        }
        self._optimiser.state[parameter] = {name: value.to(self._device) for name, value in found.items()}
        if not found:
            del self._optimiser.state[parameter]

    def _identity(self) -> str:
        """What a saved state must agree with; learning rate, batch and the like may change on resumption."""
        layout = self.layout
        return json.dumps(
            {
                "version": 2,
                "task": [layout.name, layout.state_dim, layout.action_dim],
                "seed": self._seed,
                "model": self.model.model_dump(mode="json"),
            },
            sort_keys=True,
        )


def _adam(ensemble: Ensemble, config: LearnerConfig) -> torch.optim.Adam:
    """Adam that adds 2 lambda_l W_l, the gradient of Eq. (4), term 4, to what backward left.

    So clipping does not see it; it is thousands of times smaller than the norm at which clipping begins.
    """
    free = [ensemble.max_log_var, ensemble.min_log_var]
    groups: list[dict[str, Any]] = [{"params": free}]
    for rate, weight, bias in zip(config.loss.decay, ensemble.weights, ensemble.biases, strict=True):
        groups.append({"params": [weight], "weight_decay": 2 * rate})
        groups.append({"params": [bias], "weight_decay": 2 * rate if config.loss.decay_biases else 0.0})
    return torch.optim.Adam(groups, lr=config.learning_rate, fused=True)


def _dimension_weights(
    weights: dict[str, float], layout: StateLayout, coordinates: Coordinates, device: str
) -> Tensor | None:
    """Group weights → (D,), or None when every dimension weighs 1. Raises ValueError on an unknown group."""
    unknown = sorted(weights.keys() - {group.name for group in layout.groups})
    if unknown:
        raise ValueError(f"loss.group_weights: {layout.name} has no group {unknown[0]}")
    if not weights:
        return None
    result = torch.ones(coordinates.changes)
    for group in layout.groups:
        result[coordinates.part(group)] = weights.get(group.name, 1.0)
    return result.to(device)

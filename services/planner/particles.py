"""The ensemble as P independent networks, laid out for speed: what a plan spends its time in.

Each particle is one member with one Dropout mask. Normaliser, target scale and mask are folded into its own
copy of the weights once a snapshot, so that a step is matrix products and SiLU alone.
Letters: B members, M masks, P = B·M particles, N candidates, I inputs, S state, A action.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.nn.functional import silu, softplus

from common.model.coordinates import Coordinates, RawCoordinates
from common.model.dynamics import Dynamics
from common.model.masks import MaskPool

# Rows of 512 hidden units, in and out, that fit a core's 2 MB. Measured at 20 particles x 500 candidates:
# 137 GFLOP/s in parts of one particle, 94 all at once; at 5 x 64, all at once is 5 % faster than apart.
_ROWS_IN_CACHE = 384

_silu_backward = torch.ops.aten.silu_backward


class ParticleModel(Protocol):
    """What the planner asks of a dynamics model."""

    particles: int

    def step(self, state: Tensor, action: Tensor, noise: torch.Generator | None = None) -> Tensor:
        """State (P, N, S), or (P, 1, S) if all candidates share it, and action (N, A) → (P, N, S).

        With `noise` the next state is drawn from the predicted Gaussian, else it is its mean.
        """
        ...


@dataclass(frozen=True)
class Layer:
    """A linear layer of each particle: weights (P, in, out) and biases (P, 1, out)."""

    weight: Tensor
    bias: Tensor

    @cached_property
    def transposed(self) -> Tensor:
        """Weights (P, out, in), for gradients; a copy, since a view costs a third more at few candidates."""
        return self.weight.transpose(1, 2).contiguous()

    def of(self, part: slice) -> Layer:
        """The layer of some particles."""
        return Layer(self.weight[part], self.bias[part])

    def __call__(self, x: Tensor) -> Tensor:
        """(P, N, in) → (P, N, out)."""
        return torch.baddbmm(self.bias, x, self.weight)

    def pull_back(self, gradient: Tensor) -> Tensor:
        """Gradient for the outputs (P, N, out) → for the inputs (P, N, in)."""
        return torch.bmm(gradient, self.transposed)


class Network:
    """P multilayer perceptrons with SiLU between their layers."""

    def __init__(self, layers: Sequence[Layer]) -> None:
        self.layers = tuple(layers)
        self.particles = layers[0].weight.shape[0]
        self._parts: dict[int, list[tuple[slice, tuple[Layer, ...]]]] = {}

    def evaluate(self, x: Tensor, first: Layer | None = None) -> Tensor:
        """Inputs (P, N, I) → outputs (P, N, O), without a record for gradients.

        `first` replaces the first layer, for inputs of which a part is already summed up in its bias.
        """
        together = self._together(x)
        if together >= self.particles:
            return _forward(x, self.layers if first is None else (first, *self.layers[1:]))
        out = x.new_empty(*x.shape[:2], self.layers[-1].weight.shape[2])
        for part, layers in self._split(together):
            out[part] = _forward(x[part], layers if first is None else (first.of(part), *layers[1:]))
        return out

    def evaluate_saving(self, x: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Inputs (P, N, I) → outputs (P, N, O), and each hidden layer before its SiLU (P, N, hidden)."""
        saved: list[Tensor] = []
        for layer in self.layers[:-1]:
            saved.append(layer(x))
            x = silu(saved[-1])
        return self.layers[-1](x), saved

    def pull_back(self, gradient: Tensor, saved: Sequence[Tensor]) -> Tensor:
        """Gradient for the outputs (P, N, O) → gradient for the inputs (P, N, I)."""
        for layer, before in zip(self.layers[:0:-1], reversed(saved), strict=True):
            gradient = _silu_backward(layer.pull_back(gradient), before)
        return self.layers[0].pull_back(gradient)

    def _together(self, x: Tensor) -> int:
        """Particles evaluated at once: all, but on CPU no more than keep their activations in the cache."""
        return self.particles if x.device.type != "cpu" else max(1, _ROWS_IN_CACHE // x.shape[1])

    def _split(self, together: int) -> list[tuple[slice, tuple[Layer, ...]]]:
        """The network in parts of `together` particles; views, made once."""
        if together not in self._parts:
            starts = range(0, self.particles, together)
            parts = [slice(start, start + together) for start in starts]
            self._parts[together] = [(part, tuple(layer.of(part) for layer in self.layers)) for part in parts]
        return self._parts[together]


@dataclass(frozen=True)
class NoiseHead:
    """Bounds of the log-variance (S,) and the scale (S,) from target to state units."""

    max_log_var: Tensor
    min_log_var: Tensor
    scale: Tensor

    def draw(self, raw_log_var: Tensor, generator: torch.Generator) -> Tensor:
        """Aleatoric noise (P, N, S), state units, for the head's raw log-variance (P, N, S)."""
        below = self.max_log_var - softplus(self.max_log_var - raw_log_var)
        log_var = self.min_log_var + softplus(below - self.min_log_var)
        white = torch.randn(raw_log_var.shape, generator=generator, device=generator.device)
        return white.to(raw_log_var) * (0.5 * log_var).exp() * self.scale


class Particles:
    """The planner's model: s' = s moved by f_p(s, a), for P particles and N candidates at once."""

    def __init__(
        self, network: Network, coordinates: Coordinates, noise_head: NoiseHead | None = None
    ) -> None:
        self.network = network
        self.particles = network.particles
        self._coordinates = coordinates
        self._raw = isinstance(coordinates, RawCoordinates)
        self._noise_head = noise_head
        self._offset: Tensor | None = None

    def corrected(self, offset: Tensor) -> Particles:
        """The same networks, with `offset` (P, 1, D) added to every change that they predict."""
        other = copy(self)
        other._offset = offset
        return other

    def compared(self, state: Tensor, action: Tensor, next_state: Tensor) -> tuple[Tensor, Tensor]:
        """The true change (D,) and what each network predicts (P, 1, D), without any offset.

        One step: state and next state (S,), action (A,).
        """
        change = self._coordinates.change(state, next_state)
        predicted = self._evaluate(state.expand(self.particles, 1, -1), action[None])
        return change, predicted[..., : len(change)]

    def step(self, state: Tensor, action: Tensor, noise: torch.Generator | None = None) -> Tensor:
        """As `ParticleModel.step`; differentiable in state and action unless `noise` is given."""
        if torch.is_grad_enabled() and (state.requires_grad or action.requires_grad):
            inputs = self._coordinates.encode(*_aligned(state, action))
            change: Tensor = _Change.apply(inputs, self.network)  # pyright: ignore[reportAssignmentType]
            return self._coordinates.moved(state, self._with_offset(change))
        delta = self._evaluate(state, action)
        if noise is not None:
            delta = self._drawn(delta, noise)
        return self._coordinates.moved(state, self._with_offset(delta))

    def _with_offset(self, change: Tensor) -> Tensor:
        return change if self._offset is None else change + self._offset

    def _evaluate(self, state: Tensor, action: Tensor) -> Tensor:
        if not self._raw or not state.shape[1] == 1 < len(action):
            return self.network.evaluate(self._coordinates.encode(*_aligned(state, action)))
        # All candidates start at one state: its share of the first layer is summed up once, as a bias.
        first, S = self.network.layers[0], state.shape[2]
        bias = torch.baddbmm(first.bias, state, first.weight[:, :S])
        return self.network.evaluate(action.expand(self.particles, -1, -1), Layer(first.weight[:, S:], bias))

    def _drawn(self, output: Tensor, noise: torch.Generator) -> Tensor:
        """Head's mean and log-variance (P, N, 2 D) → a sample of the change (P, N, D)."""
        if self._noise_head is None:
            raise ValueError("these particles were built without the variance head")
        mean, raw_log_var = output.chunk(2, dim=-1)
        return mean + self._noise_head.draw(raw_log_var, noise)


def particles(
    dynamics: Dynamics,
    pool: MaskPool | None,
    members: int,
    masks: int,
    *,
    sampled: bool = False,
    device: str | torch.device = "cpu",
) -> Particles:
    """The first `members` of a model, each with the first `masks` of its planning pool (None: no Dropout).

    `sampled` keeps the variance head, which means alone do not need. Raises ValueError when the model has
    fewer members or masks.
    """
    weights, biases = _folded(dynamics, members)
    changes = dynamics.coordinates.changes
    if not sampled:
        weights[-1], biases[-1] = weights[-1][..., :changes], biases[-1][..., :changes]
    if pool is not None:
        kept = [layer[:members] for layer in pool.particles(masks)]
        weights, biases = _with_masks(weights, biases, kept)
    pairs = zip(weights, biases, strict=True)
    network = Network([Layer(_as_weight(weight, device), _as_weight(bias, device)) for weight, bias in pairs])
    head = _noise_head(dynamics, device) if sampled else None
    return Particles(network, dynamics.coordinates.to(device), head)


def _folded(dynamics: Dynamics, members: int) -> tuple[list[Tensor], list[Tensor]]:
    """Weights (B, in, out) and biases, float64, that take raw inputs and give the raw change."""
    ensemble, scale = dynamics.ensemble, dynamics.normaliser
    weights = [weight.detach()[:members].double() for weight in ensemble.weights]
    biases = [bias.detach()[:members].double() for bias in ensemble.biases]
    if len(weights[0]) < members:
        raise ValueError(f"{members} members wanted from an ensemble of {len(weights[0])}")
    weights[0] = weights[0] / scale.input_std.double()[:, None]
    biases[0] = biases[0] - scale.input_mean.double()[None] @ weights[0]
    if dynamics.standardised_targets:
        _scale_mean_head(weights, biases, scale.delta_mean.double(), scale.delta_std.double())
    return weights, biases


def _scale_mean_head(weights: list[Tensor], biases: list[Tensor], mean: Tensor, std: Tensor) -> None:
    """Make the head's mean half raw: delta = std·output + mean; the log-variance half stays as it is."""
    rest = weights[-1].shape[-1] - len(std)
    factor = torch.cat((std, std.new_ones(rest)))
    weights[-1] = weights[-1] * factor
    biases[-1] = biases[-1] * factor + torch.cat((mean, mean.new_zeros(rest)))


def _with_masks(
    weights: Sequence[Tensor], biases: Sequence[Tensor], masks: Sequence[Tensor]
) -> tuple[list[Tensor], list[Tensor]]:
    """A copy of each member (B, in, out) per mask (B, M, hidden): (B·M, in, out)."""
    M = masks[0].shape[1]
    repeated = [weight.repeat_interleave(M, dim=0) for weight in weights]
    for layer, mask in enumerate(masks, start=1):
        repeated[layer] = repeated[layer] * mask.to(weights[0]).flatten(0, 1)[:, :, None]
    return repeated, [bias.repeat_interleave(M, dim=0) for bias in biases]


def _noise_head(dynamics: Dynamics, device: str | torch.device) -> NoiseHead:
    ensemble, std = dynamics.ensemble, dynamics.normaliser.delta_std
    scale = std if dynamics.standardised_targets else torch.ones_like(std)
    bounds = (ensemble.max_log_var.detach(), ensemble.min_log_var.detach())
    return NoiseHead(*(_as_weight(tensor, device) for tensor in (*bounds, scale)))


def _as_weight(tensor: Tensor, device: str | torch.device) -> Tensor:
    return tensor.to(device, torch.float32).contiguous()


def _aligned(state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
    """State (P, N or 1, S) and action (N, A), for each particle and candidate: (P, N, S), (P, N, A)."""
    return state.expand(-1, len(action), -1), action.expand(state.shape[0], -1, -1)


def _forward(x: Tensor, layers: Sequence[Layer]) -> Tensor:
    for layer in layers[:-1]:
        x = silu(layer(x), inplace=True)
    return layers[-1](x)


class _Change(torch.autograd.Function):
    """The networks' mean change, with a gradient for the inputs and none for the weights."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, network: Network) -> Tensor:
        change, saved = network.evaluate_saving(inputs)
        ctx.network, ctx.saved = network, saved
        return change

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return ctx.network.pull_back(gradients[0].contiguous(), ctx.saved), None

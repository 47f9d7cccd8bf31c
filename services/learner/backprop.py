"""The ensemble with its backward pass written out, for training: faster on a CPU than autograd's.

Autograd allocates every weight gradient anew and sums those of step 1 and step 2 in another pass; here each
product is added to `.grad` as it is computed.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import silu

from common.model.ensemble import Ensemble
from common.model.masks import Masks


class TrainedEnsemble(Ensemble):
    """Same parameters and arithmetic as Ensemble; backward writes into `.grad` after `start_gradient`."""

    def __init__(
        self, weights: Sequence[Tensor], biases: Sequence[Tensor], max_log_var: Tensor, min_log_var: Tensor
    ) -> None:
        super().__init__(weights, biases, max_log_var, min_log_var)
        self._written: set[int] = set()  # layers whose `.grad` belongs to the present gradient step

    @staticmethod
    def like(ensemble: Ensemble) -> TrainedEnsemble:
        """The given ensemble, its tensors shared."""
        weights, biases = [w.detach() for w in ensemble.weights], [b.detach() for b in ensemble.biases]
        bounds = ensemble.max_log_var.detach(), ensemble.min_log_var.detach()
        return TrainedEnsemble(weights, biases, *bounds)

    def forward(self, x: Tensor, masks: Sequence[Tensor] | None = None) -> tuple[Tensor, Tensor]:
        """Features (B, N, I) → mean and log-variance, (B, N, S) each, as Ensemble."""
        held = None if masks is None else tuple(masks)
        out = _Network.apply(x, held, self._written, *self.weights, *self.biases)
        assert isinstance(out, Tensor)
        mean, raw_log_var = torch.split(out, self.state_dim, dim=-1)
        return mean, self.clamp(raw_log_var)

    def start_gradient(self) -> None:
        """Forget the gradients of the step before: the next backward overwrites them, later ones add."""
        for parameter in self.parameters():
            if parameter.grad is None:
                parameter.grad = torch.zeros_like(parameter)
        for bound in (self.max_log_var, self.min_log_var):
            _grad(bound).zero_()
        self._written.clear()


class _Network(torch.autograd.Function):
    """x, masks, layers with a gradient, L weights, L biases → output of the head (B, N, 2 S)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, masks: Masks | None, written: set[int], *parameters: Tensor) -> Tensor:
        """Output (B, N, 2 S) for inputs x (B, N, I); `written` names the layers that have a gradient."""
        layers = len(parameters) // 2
        weights, biases = parameters[:layers], parameters[layers:]
        inputs, sums = [x], []
        for layer in range(layers - 1):
            sums.append(torch.baddbmm(biases[layer], inputs[-1], weights[layer]))
            h = silu(sums[-1])
            inputs.append(h if masks is None else h.mul_(masks[layer]))
        ctx.parameters, ctx.masks, ctx.written = parameters, masks, written
        ctx.save_for_backward(*inputs, *sums)
        return torch.baddbmm(biases[-1], inputs[-1], weights[-1])

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] - the decorator hides the names
        ctx: Any, g: Tensor
    ) -> tuple[Tensor | None, ...]:
        """Gradient of x (B, N, I) for that of the output g (B, N, 2 S); the weights' are written in place."""
        parameters, masks = ctx.parameters, ctx.masks
        layers = len(parameters) // 2
        inputs, sums = ctx.saved_tensors[:layers], ctx.saved_tensors[layers:]
        for layer in reversed(range(layers)):
            weight, bias = parameters[layer], parameters[layers + layer]
            _add_product(weight, bias, inputs[layer], g, layer in ctx.written)
            ctx.written.add(layer)
            if layer == 0:
                break
            g = torch.bmm(g, weight.transpose(1, 2))
            if masks is not None:
                g.mul_(masks[layer - 1])
            torch.ops.aten.silu_backward.grad_input(g, sums[layer - 1], grad_input=g)
        dx = torch.bmm(g, parameters[0].transpose(1, 2)) if ctx.needs_input_grad[0] else None
        return dx, None, None, *([None] * len(parameters))


def _add_product(weight: Tensor, bias: Tensor, h: Tensor, g: Tensor, add: bool) -> None:
    """Gradients of a layer with input h (B, N, in) and output gradient g (B, N, out)."""
    if add:
        _grad(weight).baddbmm_(h.transpose(1, 2), g)
        _grad(bias).add_(g.sum(dim=1, keepdim=True))
    else:
        torch.bmm(h.transpose(1, 2), g, out=_grad(weight))
        torch.sum(g, dim=1, keepdim=True, out=_grad(bias))


def _grad(parameter: Tensor) -> Tensor:
    assert parameter.grad is not None, "start_gradient comes before backward"
    return parameter.grad


def keep_freed_memory() -> bool:
    """Tell glibc to keep freed memory in this process instead of giving it back after each gradient step.

    Fetching it again costs a page fault per 4 KiB, a tenth of the step. False where there is no glibc.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    trim_threshold, mmap_threshold = -1, -3
    return bool(mallopt(trim_threshold, 1 << 30)) and bool(mallopt(mmap_threshold, 1 << 30))

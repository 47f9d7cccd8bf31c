"""What networks and optimisers have learned, as named tensors that fit into one file without a pickle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Optimizer


def gather(owner: object, optimisers: Mapping[str, Optimizer]) -> dict[str, Tensor]:
    """Copies of all parameters and buffers of the owner's networks, and each optimiser's moments."""
    found: dict[str, Tensor] = {}
    for name, module in _networks(owner).items():
        found |= {f"{name}.{key}": tensor for key, tensor in module.state_dict().items()}
    for name, optimiser in optimisers.items():
        for number, moments in optimiser.state_dict()["state"].items():
            found |= {f"{name}/{number}/{key}": torch.as_tensor(value) for key, value in moments.items()}
    return {name: tensor.detach().clone() for name, tensor in found.items()}


def spread(tensors: Mapping[str, Tensor], owner: object, optimisers: Mapping[str, Optimizer]) -> None:
    """Put back what `gather` took. Raises RuntimeError if a network's tensors are missing or misshapen."""
    for name, module in _networks(owner).items():
        module.load_state_dict(_under(tensors, f"{name}."))
    for name, optimiser in optimisers.items():
        moments: dict[int, dict[str, Any]] = {}
        for key, tensor in _under(tensors, f"{name}/").items():
            number, _, kind = key.partition("/")
            moments.setdefault(int(number), {})[kind] = tensor.clone()
        optimiser.load_state_dict({**optimiser.state_dict(), "state": moments})


def _networks(owner: object) -> dict[str, nn.Module]:
    return {name: part for name, part in vars(owner).items() if isinstance(part, nn.Module)}


def _under(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}

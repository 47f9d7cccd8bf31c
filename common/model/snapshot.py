"""What the learner hands to the planner: weights, normaliser and planning masks as one unit with a digest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
from pydantic import Field, ValidationError
from torch import Tensor

from common.config import Frozen
from common.model.choose import StateLayout, coordinates_of
from common.model.config import ModelConfig
from common.model.dynamics import Dynamics
from common.model.ensemble import Ensemble
from common.model.masks import MaskPool
from common.model.normaliser import Normaliser
from common.model.sealed import SealError, content_digest, seal, unseal

VERSION = 2


class SnapshotRefused(Exception):  # noqa: N818 - reads as what happened
    """A snapshot that must not be used; the message is one line that says why."""


class SnapshotMeta(Frozen):
    """What a snapshot says of itself."""

    version: int = VERSION
    task: str
    state_dim: int = Field(ge=1, le=65536, description="S")
    action_dim: int = Field(ge=1, le=65536, description="A")
    inputs: int = Field(ge=1, le=65536, description="I, features of the networks' input")
    changes: int = Field(ge=1, le=65536, description="D, numbers that the networks predict")
    counter: int = Field(ge=0, description="snapshots that this learner made before")
    episodes: int = Field(ge=0, description="training episodes that the weights have seen")
    model: ModelConfig


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A trained model, immutable. Shapes as in Ensemble, Normaliser and MaskPool; float32 throughout."""

    meta: SnapshotMeta
    weights: tuple[Tensor, ...]
    biases: tuple[Tensor, ...]
    max_log_var: Tensor
    min_log_var: Tensor
    normaliser: Normaliser
    masks: MaskPool

    @staticmethod
    def of(dynamics: Dynamics, masks: MaskPool, meta: SnapshotMeta) -> Snapshot:
        """A copy of a model as it is now: later training does not change it."""
        ensemble = dynamics.ensemble
        return Snapshot(
            meta=meta,
            weights=tuple(_copy(weight) for weight in ensemble.weights),
            biases=tuple(_copy(bias) for bias in ensemble.biases),
            max_log_var=_copy(ensemble.max_log_var),
            min_log_var=_copy(ensemble.min_log_var),
            normaliser=dynamics.normaliser.to("cpu"),
            masks=masks.to("cpu"),
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256, in hex, of everything in the snapshot."""
        return content_digest(self.tensors(), self.meta.model_dump_json())

    @property
    def id(self) -> str:
        """Short name; equal snapshots have equal ids on every machine."""
        return self.digest[:16]

    def tensors(self) -> dict[str, Tensor]:
        """Every tensor by the name that it has in the file."""
        named = {f"weight.{i}": tensor for i, tensor in enumerate(self.weights)}
        named |= {f"bias.{i}": tensor for i, tensor in enumerate(self.biases)}
        named |= {f"mask.{i}": tensor for i, tensor in enumerate(self.masks.layers)}
        named |= {f"normaliser.{name}": tensor for name, tensor in self.normaliser.tensors().items()}
        return named | {"max_log_var": self.max_log_var, "min_log_var": self.min_log_var}

    def to_bytes(self) -> bytes:
        """One safetensors file; equal snapshots give equal bytes."""
        return seal(self.tensors(), self.meta.model_dump_json())

    @staticmethod
    def from_bytes(payload: bytes) -> Snapshot:
        """Read and check a snapshot. Raises SnapshotRefused, and nothing else, whatever the bytes are."""
        try:
            tensors, text = unseal(payload)
            meta = SnapshotMeta.model_validate_json(text)
        except SealError as error:
            raise SnapshotRefused(str(error)) from None
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise SnapshotRefused(f"metadata: {where or 'text'}: {first['type']}") from None
        if meta.version != VERSION:
            raise SnapshotRefused(f"version {meta.version}; this program reads {VERSION}")
        _check(tensors, meta)
        return _assemble(tensors, meta)

    def dynamics(self, layout: StateLayout, device: str = "cpu") -> Dynamics:
        """The model, without weight gradients. Raises SnapshotRefused when it was made for another task."""
        meta = self.meta
        made_for = (meta.task, meta.state_dim, meta.action_dim)
        wanted = (layout.name, layout.state_dim, layout.action_dim)
        if made_for != wanted:
            raise SnapshotRefused(f"made for task, S, A = {made_for}, not {wanted}".replace("'", ""))
        coordinates = coordinates_of(meta.model.coordinates, layout)
        if (coordinates.inputs, coordinates.changes) != (meta.inputs, meta.changes):
            raise SnapshotRefused(f"made for other {meta.model.coordinates} coordinates than this program's")
        ensemble = Ensemble(self.weights, self.biases, self.max_log_var, self.min_log_var)
        standardised = self.meta.model.targets == "standardised"
        model = Dynamics(ensemble.requires_grad_(False), self.normaliser, coordinates, standardised)
        return model.to(device)


def _copy(tensor: Tensor) -> Tensor:
    return tensor.detach().cpu().clone()


def _shapes(meta: SnapshotMeta) -> dict[str, tuple[int, ...]]:
    """Name → shape of every tensor that a snapshot of this description must hold."""
    model, inputs, D = meta.model, meta.inputs, meta.changes
    shapes: dict[str, tuple[int, ...]] = {"max_log_var": (D,), "min_log_var": (D,)}
    for layer, (fan_in, fan_out) in enumerate(model.layer_sizes(inputs, 2 * D)):
        shapes[f"weight.{layer}"] = (model.members, fan_in, fan_out)
        shapes[f"bias.{layer}"] = (model.members, 1, fan_out)
    for layer, width in enumerate(model.hidden):
        shapes[f"mask.{layer}"] = (model.members, model.plan_masks, width)
    for name, width in (("input", inputs), ("delta", D)):
        shapes |= {f"normaliser.{name}_mean": (width,), f"normaliser.{name}_std": (width,)}
    return shapes


def _check(tensors: Mapping[str, Tensor], meta: SnapshotMeta) -> None:
    expected = _shapes(meta)
    if tensors.keys() != expected.keys():
        odd = sorted(tensors.keys() ^ expected.keys())
        raise SnapshotRefused(f"tensor {odd[0]!r} is missing or not known")
    for name, shape in expected.items():
        tensor = tensors[name]
        if tuple(tensor.shape) != shape:
            raise SnapshotRefused(f"{name} has shape {tuple(tensor.shape)}, not {shape}")
        if tensor.dtype != torch.float32:
            raise SnapshotRefused(f"{name} is {tensor.dtype}, not torch.float32")
        if not bool(torch.isfinite(tensor).all()):
            raise SnapshotRefused(f"{name} is not finite")
        if name.endswith("_std") and not bool((tensor > 0).all()):
            raise SnapshotRefused(f"{name} is not positive")


def _assemble(tensors: Mapping[str, Tensor], meta: SnapshotMeta) -> Snapshot:
    layers = range(len(meta.model.hidden) + 1)
    prefix = "normaliser."
    statistics = {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}
    return Snapshot(
        meta=meta,
        weights=tuple(tensors[f"weight.{i}"] for i in layers),
        biases=tuple(tensors[f"bias.{i}"] for i in layers),
        max_log_var=tensors["max_log_var"],
        min_log_var=tensors["min_log_var"],
        normaliser=Normaliser(**statistics),
        masks=MaskPool(tuple(tensors[f"mask.{i}"] for i in layers[:-1])),
    )

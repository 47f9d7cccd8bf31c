"""Dataset standardisation: what the paper calls BN, Eq. (3); a mean and a deviation per dimension."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

FloatArray = NDArray[np.float32] | NDArray[np.float64]

# A dimension that never moves would be divided by zero; below this its deviation counts as 1.
SMALLEST_DEVIATION = 1e-12


@dataclass(frozen=True)
class Normaliser:
    """Mean and standard deviation of networks' inputs (I,) and of state changes (D,), float32."""

    input_mean: Tensor
    input_std: Tensor
    delta_mean: Tensor
    delta_std: Tensor

    @staticmethod
    def identity(inputs: int, changes: int) -> Normaliser:
        """The normaliser that changes nothing: means 0, deviations 1."""
        return Normaliser(*(make(width) for width in (inputs, changes) for make in (torch.zeros, torch.ones)))

    def standardised(self, inputs: Tensor) -> Tensor:
        """BN of Eq. (3), (.., I)."""
        return (inputs - self.input_mean) * self.input_std.reciprocal()

    def tensors(self) -> dict[str, Tensor]:
        """The four tensors by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def to(self, device: torch.device | str) -> Normaliser:
        """The same statistics on `device`."""
        return Normaliser(**{name: tensor.to(device) for name, tensor in self.tensors().items()})


class RunningMoments:
    """Mean and variance that grow by one episode at a time, so that a refit costs nothing."""

    def __init__(self, inputs: int, changes: int) -> None:
        self._parts = [_Moments(width) for width in (inputs, changes)]

    def update(self, inputs: FloatArray, changes: FloatArray) -> None:
        """Add rows of inputs (N, I) and state changes (N', D)."""
        for part, rows in zip(self._parts, (inputs, changes), strict=True):
            part.update(rows)

    def normaliser(self) -> Normaliser:
        """Statistics of everything added so far; before the first row, the identity."""
        return Normaliser(*(tensor for part in self._parts for tensor in part.tensors()))


class _Moments:
    """Count, mean (D,) and sum of squared deviations (D,), float64."""

    def __init__(self, width: int) -> None:
        self.count = 0
        self.mean = np.zeros(width)
        self.squares = np.zeros(width)

    def update(self, rows: FloatArray) -> None:
        """Merge rows (N, D) by Chan's formula, which does not lose small deviations of large values."""
        if len(rows) == 0:
            return
        added = rows.astype(np.float64)
        # Measured from a row, a constant dimension has a deviation of exactly 0.
        offset = added - added[0]
        mean = added[0] + offset.mean(axis=0)
        shift, total = mean - self.mean, self.count + len(rows)
        weight = self.count * len(rows) / total
        self.squares += offset.var(axis=0) * len(rows) + shift**2 * weight
        self.mean += shift * (len(rows) / total)
        self.count = total

    def tensors(self) -> tuple[Tensor, Tensor]:
        """Mean (D,) and deviation (D,), float32."""
        deviation = np.sqrt(self.squares / max(1, self.count))
        deviation = np.where(deviation < SMALLEST_DEVIATION, 1.0, deviation)
        return torch.as_tensor(self.mean.astype(np.float32)), torch.as_tensor(deviation.astype(np.float32))

"""Dropout particles z of Eq. (1): Bernoulli masks, drawn once and then kept.

Letters: B members, P masks in a member's pool, M masks used, N rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

Masks = tuple[Tensor, ...]


@dataclass(frozen=True)
class MaskPool:
    """P masks a member; mask p of member b is `layers[l][b, p]` in every hidden layer l together.

    `layers[l]` is (B, P, hidden_l), float32 of 0 (dropped) and 1 (kept).
    """

    layers: Masks

    @staticmethod
    def draw(
        members: int, size: int, hidden: Sequence[int], dropout: float, generator: torch.Generator
    ) -> MaskPool:
        """Draw a pool of `size` masks a member; `dropout` is the probability of a 0."""
        return MaskPool(
            tuple(
                (torch.rand((members, size, width), generator=generator) >= dropout).float()
                for width in hidden
            )
        )

    @property
    def members(self) -> int:
        return self.layers[0].shape[0]

    @property
    def size(self) -> int:
        return self.layers[0].shape[1]

    def pick(self, rows: int, generator: torch.Generator) -> Masks:
        """For training: a mask picked afresh for each of N rows and each member; layers (B, N, hidden)."""
        chosen = torch.randint(self.size, (self.members, rows), generator=generator)
        flat = (chosen + self.size * torch.arange(self.members)[:, None]).flatten()
        flat = flat.to(self.layers[0].device)
        return tuple(
            layer.flatten(0, 1).index_select(0, flat).view(self.members, rows, layer.shape[2])
            for layer in self.layers
        )

    def particles(self, count: int) -> Masks:
        """For planning: `count` fixed masks a member; layers (B, M, hidden).

        They are the first of the pool, which is as random as any choice, so that all candidates of a plan,
        and all plans with one model, meet the same particles.
        """
        if not 1 <= count <= self.size:
            raise ValueError(f"{count} particles wanted from a pool of {self.size} masks")
        return tuple(layer[:, :count] for layer in self.layers)

    def to(self, device: torch.device | str) -> MaskPool:
        """The same masks on `device`."""
        return MaskPool(tuple(layer.to(device) for layer in self.layers))

"""One episode: what it holds, what is refused, and its bytes on disk.

Letters: T steps, S state, A action, G goal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from common.config import Frozen
from common.model.sealed import SealError, seal, unseal

Float32 = NDArray[np.float32]


class EpisodeRefused(Exception):  # noqa: N818 - reads as what happened
    """An episode that must not be learned from; the message is one line that says why."""


@dataclass(frozen=True, eq=False)
class Episode:
    """A recorded episode; states[t] → actions[t] → states[t + 1]."""

    boot_id: int  # the plant's, when it ran
    episode: int  # given out once in a run: the identity of an episode
    mode: str  # random, plan or glove
    states: Float32  # (T + 1, S)
    actions: Float32  # (T, A), normalised, as executed
    goal: Float32  # (G,)
    valid: NDArray[np.bool_]  # (T + 1,), whether every part of a state was measured


class _Label(Frozen):
    boot_id: int = Field(ge=0)
    episode: int = Field(ge=0)
    mode: str


def check(episode: Episode, state_dim: int, action_dim: int) -> None:
    """Raise EpisodeRefused unless the episode is of training mode, well shaped, float32 and finite."""
    steps = len(episode.actions)
    shapes = {"states": (steps + 1, state_dim), "actions": (steps, action_dim), "valid": (steps + 1,)}
    if episode.mode == "evaluate":
        raise EpisodeRefused("evaluation episodes never enter the replay")
    for name, shape in shapes.items():
        if getattr(episode, name).shape != shape:
            raise EpisodeRefused(f"{name} has shape {getattr(episode, name).shape}, not {shape}")
    for name in ("states", "actions", "goal"):
        array: Float32 = getattr(episode, name)
        if array.dtype != np.float32:
            raise EpisodeRefused(f"{name} is {array.dtype}, not float32")
        if not np.isfinite(array).all():
            raise EpisodeRefused(f"{name} is not finite")


def to_bytes(episode: Episode) -> bytes:
    """Episode → one sealed safetensors file."""
    label = _Label(boot_id=episode.boot_id, episode=episode.episode, mode=episode.mode)
    arrays = {
        "states": episode.states,
        "actions": episode.actions,
        "goal": episode.goal,
        "valid": episode.valid,
    }
    return seal({name: torch.as_tensor(array) for name, array in arrays.items()}, label.model_dump_json())


def from_bytes(payload: bytes) -> Episode:
    """Read an episode. Raises EpisodeRefused on bytes that `to_bytes` did not make."""
    try:
        tensors, text = unseal(payload)
        label = _Label.model_validate_json(text)
        arrays = {name: tensors[name].numpy() for name in ("states", "actions", "goal", "valid")}
    except (SealError, ValidationError, KeyError) as error:
        raise EpisodeRefused(f"not an episode file: {type(error).__name__}") from None
    return Episode(boot_id=label.boot_id, episode=label.episode, mode=label.mode, **arrays)

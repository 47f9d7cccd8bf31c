"""All training data in memory: contiguous float32 rows, and the two-step windows of Eq. (4) over them.

Letters: B members, N windows, S state, A action, T steps of an episode.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.model.coordinates import Coordinates, RawCoordinates
from common.model.normaliser import Normaliser, RunningMoments
from services.learner.episode import Episode, Float32

Split = Literal["train", "holdout"]
_GOLDEN = (math.sqrt(5) - 1) / 2


class Windows(NamedTuple):
    """{s_t, a_t, s_t+1, a_t+1, s_t+2} of Eq. (4); states (B, N, S), actions (B, N, A)."""

    state: Tensor
    action: Tensor
    next_state: Tensor
    next_action: Tensor
    last_state: Tensor


class Trajectories(NamedTuple):
    """Runs of h steps; states (N, h + 1, S), actions (N, h, A)."""

    states: Tensor
    actions: Tensor


class Replay:
    """Grows by whole episodes; a window never crosses an episode nor touches an invalid state.

    `coordinates` say what its statistics are of; None: of state and action as they are. `lost` tells of
    states (T + 1, S) whether the object has left the hand: a window may end in the first such state, which
    shows how it is lost, and none goes on from there, for nothing depends on how it falls and lies.
    """

    def __init__(
        self,
        state_dim: int,
        action_dim: int,
        holdout: float = 0.0,
        coordinates: Coordinates | None = None,
        *,
        lost: Callable[[Float32], NDArray[np.bool_]] | None = None,
    ) -> None:
        self.state_dim, self.action_dim = state_dim, action_dim
        self.episodes = {"train": 0, "holdout": 0}
        self._lost = lost
        self._holdout = holdout
        self._coordinates = coordinates or RawCoordinates(state_dim, action_dim)
        self._states = _Rows(state_dim)
        self._actions = _Rows(action_dim)
        # run[i]: how many valid steps follow row i within its episode; -1 when row i itself is invalid
        self._run = _Rows(1, np.int64)
        self._splits = {"train": _Split(), "holdout": _Split()}
        self._moments = RunningMoments(self._coordinates.inputs, self._coordinates.changes)

    def add(self, episode: Episode) -> Split:
        """Append one checked episode; returns the split that it went to."""
        first, runs = len(self._states), _valid_runs(self._told(episode))
        self._states.extend(episode.states)
        self._actions.extend(np.concatenate((episode.actions, np.zeros((1, self.action_dim), np.float32))))
        self._run.extend(runs[:, None])
        split: Split = "holdout" if is_held_out(episode.episode, self._holdout) else "train"
        self._splits[split].extend(first + np.flatnonzero(runs >= 2))
        self.episodes[split] += 1
        if split == "train":
            self._moments.update(*self._described(episode, runs[:-1] >= 1))
        return split

    def windows(self, split: Split = "train") -> int:
        """How many two-step windows there are."""
        return len(self._splits[split].starts)

    @property
    def steps(self) -> int:
        """Transitions stored, in both splits and valid or not."""
        return len(self._states) - sum(self.episodes.values())

    def normaliser(self) -> Normaliser:
        """Statistics of the training split, from sums that each episode updated."""
        return self._moments.normaliser()

    def sample(
        self,
        members: int,
        batch: int,
        generator: torch.Generator,
        recent_fraction: float = 0.0,
        recent_episodes: int = 1,
    ) -> Windows:
        """Draw N = `batch` training windows for each of B members independently, with replacement.

        A share `recent_fraction` of them comes from the newest `recent_episodes`, the rest from all.
        """
        split = self._splits["train"]
        recent = round(batch * recent_fraction)
        oldest = split.first_of_recent(recent_episodes)
        chosen = torch.cat(
            (
                torch.randint(0, len(split.starts), (members, batch - recent), generator=generator),
                torch.randint(oldest, len(split.starts), (members, recent), generator=generator),
            ),
            dim=1,
        )
        return self._gather(torch.as_tensor(split.starts.rows[:, 0])[chosen])

    def trajectories(self, steps: int, split: Split = "holdout", limit: int = 2000) -> Trajectories:
        """At most `limit` runs of `steps` valid steps, spread evenly over the split."""
        starts = self._splits[split].starts.rows[:, 0]
        starts = starts[self._run.rows[starts, 0] >= steps]
        if len(starts) > limit:
            starts = starts[np.linspace(0, len(starts) - 1, limit).astype(np.int64)]
        rows = torch.as_tensor(starts)[:, None] + torch.arange(steps + 1)
        return Trajectories(self._states.tensor()[rows], self._actions.tensor()[rows[:, :-1]])

    def _told(self, episode: Episode) -> NDArray[np.bool_]:
        """Which states (T + 1,) may be learned from."""
        if self._lost is None:
            return episode.valid
        lost = self._lost(episode.states)
        return episode.valid & (np.cumsum(lost) - lost == 0)

    def _described(self, episode: Episode, moved: NDArray[np.bool_]) -> tuple[Float32, Float32]:
        """Inputs (T', I) and changes (T', D) of the steps (T,) that `moved` marks, as networks see them."""
        rows = (episode.states[:-1], episode.states[1:], episode.actions)
        before, after, actions = (torch.from_numpy(row[moved]) for row in rows)
        inputs = self._coordinates.encode(before, actions)
        return inputs.numpy(), self._coordinates.change(before, after).numpy()

    def _gather(self, start: Tensor) -> Windows:
        states, actions = self._states.tensor(), self._actions.tensor()

        def take(table: Tensor, offset: int) -> Tensor:
            return table.index_select(0, (start + offset).flatten()).view(*start.shape, table.shape[1])

        return Windows(take(states, 0), take(actions, 0), take(states, 1), take(actions, 1), take(states, 2))


def is_held_out(episode: int, share: float) -> bool:
    """Whether an episode is kept out of training; depends on its number alone.

    Multiples of the golden ratio spread evenly and never fall into step with a pattern of the curriculum.
    """
    return math.fmod((episode + 1) * _GOLDEN, 1.0) < share


def _valid_runs(valid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(T + 1,) flags → (T + 1,) valid steps ahead of each state, -1 where the state itself is invalid."""
    runs = np.empty(len(valid), np.int64)
    ahead = -1
    for t in range(len(valid) - 1, -1, -1):
        ahead = ahead + 1 if valid[t] else -1
        runs[t] = ahead
    return runs


class _Rows:
    """A (rows, width) array that doubles its room when it is full."""

    def __init__(self, width: int, dtype: type[np.float32] | type[np.int64] = np.float32) -> None:
        self._data = np.zeros((1024, width), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray:
        """View of the filled part."""
        return self._data[: self._count]

    def tensor(self) -> Tensor:
        """The filled part as a tensor that shares its memory."""
        return torch.as_tensor(self.rows)

    def extend(self, rows: NDArray) -> None:
        needed = self._count + len(rows)
        if needed > len(self._data):
            larger = np.zeros((max(needed, 2 * len(self._data)), self._data.shape[1]), self._data.dtype)
            larger[: self._count] = self.rows
            self._data = larger
        self._data[self._count : needed] = rows
        self._count = needed


class _Split:
    """Window starts of one split in order of arrival, and where each episode's windows begin."""

    def __init__(self) -> None:
        self.starts = _Rows(1, np.int64)
        self._firsts: list[int] = []

    def extend(self, starts: NDArray[np.int64]) -> None:
        self._firsts.append(len(self.starts))
        self.starts.extend(starts[:, None])

    def first_of_recent(self, episodes: int) -> int:
        """Index of the first window of the newest `episodes` that has any window after it."""
        recent = self._firsts[-min(episodes, len(self._firsts))]
        return min(recent, len(self.starts) - 1)

"""The replay on disk: one file an episode, written so that an acknowledged episode is never lost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.model.coordinates import Coordinates
from common.storage import sweep_partial, write_atomically
from services.learner.episode import Episode, EpisodeRefused, Float32, check, from_bytes, to_bytes
from services.learner.replay import Replay


class EpisodeStore:
    """Episodes of one task in a directory that one learner writes; `replay` holds them in memory.

    An episode is known by its id alone: the curriculum gives each out once, so a plant that runs one again
    after a restart, under another boot id, adds nothing. `corrupt` names the files that could not be used at
    opening (they stay where they are), `leftovers` counts half-written files that a dead writer left (they
    are removed).
    """

    def __init__(
        self,
        directory: Path,
        state_dim: int,
        action_dim: int,
        holdout: float = 0.0,
        coordinates: Coordinates | None = None,
        *,
        lost: Callable[[Float32], NDArray[np.bool_]] | None = None,
    ) -> None:
        self.replay = Replay(state_dim, action_dim, holdout, coordinates, lost=lost)
        self.corrupt: list[str] = []
        self._directory = directory
        self._boots: dict[int, int] = {}  # boot id of the plant by episode, in order of arrival
        self._next = 0
        directory.mkdir(parents=True, exist_ok=True)
        self.leftovers = sweep_partial(directory)
        for path in sorted(directory.glob("*.safetensors")):
            self._load(path)

    def __len__(self) -> int:
        return len(self._boots)

    def __contains__(self, episode: int) -> bool:
        return episode in self._boots

    def newest(self, count: int) -> list[tuple[int, int]]:
        """The (boot id, episode) of the `count` episodes that arrived last, oldest first."""
        return [(boot_id, episode) for episode, boot_id in list(self._boots.items())[-count:]]

    @property
    def newest_episode(self) -> int:
        """The highest episode id in the store; -1 when it is empty."""
        return max(self._boots, default=-1)

    def append(self, episode: Episode) -> bool:
        """Store an episode; when this returns it is on disk. False: one of this id is there already.

        Raises EpisodeRefused on an evaluation episode or on malformed data, and stores nothing then.
        """
        if episode.episode in self._boots:
            return False
        check(episode, self.replay.state_dim, self.replay.action_dim)
        # The number leads so that a sorted listing is the order of arrival, which "recent" rests on.
        name = f"{self._next:08d}-{episode.boot_id:x}-{episode.episode}.safetensors"
        write_atomically(self._directory / name, to_bytes(episode))
        self._next += 1
        self._remember(episode)
        return True

    def read_back(self) -> Iterator[Episode]:
        """Every episode of the store in order of arrival, from the disk."""
        seen: set[int] = set()
        for path in sorted(self._directory.glob("*.safetensors")):
            if path.name in self.corrupt:
                continue
            episode = from_bytes(path.read_bytes())
            if episode.episode not in seen:
                seen.add(episode.episode)
                yield episode

    def _load(self, path: Path) -> None:
        try:
            self._next = max(self._next, int(path.name.partition("-")[0]) + 1)
            episode = from_bytes(path.read_bytes())
            check(episode, self.replay.state_dim, self.replay.action_dim)
        except (EpisodeRefused, OSError, ValueError):
            self.corrupt.append(path.name)
            return
        if episode.episode not in self._boots:
            self._remember(episode)

    def _remember(self, episode: Episode) -> None:
        self._boots[episode.episode] = episode.boot_id
        self.replay.add(episode)

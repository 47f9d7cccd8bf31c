"""The long work of a compared method: storing its episodes and letting it learn from them, resumable.

An episode is remembered by the controller only when all updates for those before it are done, so that a run
that was interrupted does the same updates on the same data again.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from bench.baselines.controller import Controller, Trajectory, derived_seed
from common.config import ConfigError
from common.messages import Mode
from common.model.sealed import SealError, seal, unseal
from common.storage import write_atomically
from common.task import Task
from services.learner.dataset import EpisodeStore
from services.learner.episode import Episode

CHECKPOINT = "checkpoint.safetensors"
SLICE_UPDATES = 100  # of one job
SAVE_EVERY = 500  # updates between checkpoints


@dataclass(frozen=True)
class Stored:
    """An episode is on disk; `episodes` and `steps` count all that are."""

    boot_id: int
    episode: int
    episodes: int
    steps: int


@dataclass(frozen=True)
class Learned:
    """What one slice did; `after_episode` is the newest episode that was learned from."""

    losses: dict[str, float]
    updates: int
    episodes: int
    after_episode: int


class AgentWorker:
    """Owns the controller's replay and progress; its methods run as jobs, one at a time."""

    def __init__(
        self,
        directory: Path,
        task: Task,
        controller: Controller,
        *,
        identity: str,
        seed: int,
        warmup_steps: int,
    ) -> None:
        """Take up the run where it was; `identity` names what a checkpoint must agree with.

        Raises ConfigError if it does not, or if episodes are missing.
        """
        self._path = directory / CHECKPOINT
        self._task = task
        self._controller = controller
        self._identity = identity
        self._seed = seed
        self._warmup_steps = warmup_steps
        self._store = EpisodeStore(directory / "episodes", task.state_dim, task.action_dim)
        self._waiting: deque[Episode] = deque(self._store.read_back())
        self._owed = 0
        self._saved_at = 0
        self._consistent = True  # False within an update: what is half learned must not be saved
        self.newest = Learned({}, 0, 0, -1)
        if self._path.exists():
            self._resume()

    @property
    def stored(self) -> tuple[int, int]:
        """Episodes and steps on disk."""
        return len(self._store), self._store.replay.steps

    def newest_keys(self, count: int) -> list[tuple[int, int]]:
        """The (plant boot id, episode) of the episodes that were stored last, oldest first."""
        return self._store.newest(count)

    @property
    def has_work(self) -> bool:
        """Whether updates are owed."""
        ready = self.newest.episodes > 0 or self._store.replay.steps >= self._warmup_steps
        return self._owed > 0 or (ready and bool(self._waiting))

    def store(self, episode: Episode) -> Stored:
        """Write an episode; when this returns it survives any crash. Raises OSError or EpisodeRefused."""
        if self._store.append(episode):
            self._waiting.append(episode)
        return Stored(episode.boot_id, episode.episode, *self.stored)

    def learn(self) -> Learned:
        """Do the next slice of what is owed: an update for each step that was made."""
        self._consistent = False
        while not self._owed:
            self._take_next()
        updates = min(SLICE_UPDATES, self._owed)
        losses = self._controller.learn(updates, derived_seed(self._seed, "learn", self.newest.updates))
        self._owed -= updates
        done = self.newest
        self.newest = Learned(losses, done.updates + updates, done.episodes, done.after_episode)
        self._consistent = True
        if self.newest.updates - self._saved_at >= SAVE_EVERY:
            self.save()
        return self.newest

    def save(self) -> None:
        """Write a checkpoint, unless there is nothing new or an update broke off half-way."""
        if not self._consistent or self.newest.updates == self._saved_at:
            return
        progress = (self.newest.updates, self._owed, self.newest.episodes, self.newest.after_episode)
        text = json.dumps({"identity": self._identity, "progress": progress})
        write_atomically(self._path, seal(self._controller.tensors(), text))
        self._saved_at = self.newest.updates

    def _take_next(self) -> None:
        """Remember the next episode to learn from: the whole warm-up at once, then one at a time."""
        first = not self.newest.episodes
        self._owed += self._remember(self._waiting.popleft())
        while first and self._owed < self._warmup_steps:
            self._owed += self._remember(self._waiting.popleft())

    def _remember(self, episode: Episode) -> int:
        self._controller.remember(trajectory(episode, self._task))
        done = self.newest
        self.newest = Learned(done.losses, done.updates, done.episodes + 1, episode.episode)
        return len(episode.actions)

    def _resume(self) -> None:
        tensors, (updates, self._owed, episodes, after_episode) = read_checkpoint(self._path, self._identity)
        if episodes > len(self._waiting):
            raise ConfigError([f"{self._path}: has seen episodes that are missing now; move the run away"])
        for _ in range(episodes):
            self._remember(self._waiting.popleft())
        self._controller.restore(tensors)
        self.newest = Learned({}, updates, episodes, after_episode)
        self._saved_at = updates


def trajectory(episode: Episode, task: Task) -> Trajectory:
    """An episode with the environment's rewards."""
    states, goal = episode.states.astype(np.float64), episode.goal.astype(np.float64)
    rewards = np.asarray(task.env_reward(states[1:], goal)).astype(np.float32)
    planned = episode.mode == Mode.PLAN.value
    return Trajectory(episode.states, episode.actions, rewards, episode.goal, planned)


def read_checkpoint(path: Path, identity: str) -> tuple[dict[str, Tensor], list[int]]:
    """Return what a controller learned, and its updates, owed updates, episodes and newest episode.

    Raises ConfigError if there is none, or if it is not that of `identity`.
    """
    try:
        tensors, text = unseal(path.read_bytes())
    except (OSError, SealError) as error:
        raise ConfigError([f"{path}: no trained agent ({error})"]) from None
    note = json.loads(text)
    if note["identity"] != identity:
        raise ConfigError([f"{path}: belongs to another task, method, seed or setting"])
    return tensors, note["progress"]

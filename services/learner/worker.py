"""The learner's long work: storing episodes and training, always on the same worker."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

from common.storage import write_atomically
from services.learner.dataset import EpisodeStore
from services.learner.episode import Episode, EpisodeRefused
from services.learner.evaluation import ModelErrors
from services.learner.trainer import SliceMetrics, Trainer, TrainerStateRefused

CHECKPOINT = "checkpoint.safetensors"
PROGRESS = "progress.json"
SNAPSHOT = "snapshot.safetensors"
NO_STEPS = SliceMetrics(0, 0, 0.0, 0.0, {})


@dataclass(frozen=True)
class Stored:
    """An episode is on disk; `episodes` and `steps` count all that are."""

    boot_id: int
    episode: int
    mode: str
    episodes: int
    steps: int
    new: bool  # False: it was there already, perhaps from before the plant restarted


@dataclass(frozen=True)
class Unfit:
    """An episode that no further attempt could store; `reason` is one line."""

    reason: str


@dataclass(frozen=True)
class Trained:
    """What one slice of an update did; the last slice also brings the new snapshot and its errors."""

    metrics: SliceMetrics
    total_updates: int
    remaining: int
    after_episode: int
    episodes: int
    steps: int
    snapshot_id: str = ""
    payload: bytes = b""
    errors: ModelErrors = field(default_factory=lambda: ModelErrors({}, {}, {}))


class LearnerWorker:
    """Owns replay and trainer. Its methods run as jobs, one at a time, so that nothing needs a lock."""

    def __init__(self, directory: Path, store: EpisodeStore, trainer: Trainer) -> None:
        self._directory = directory
        self._store = store
        self._trainer = trainer
        self._newest = -1  # id of the newest stored episode
        self._seen_newest = -1  # of the newest episode when the present update began
        self._seen_episodes = 0
        self.note = ""
        self.resumed = self._resume()

    @property
    def stored(self) -> tuple[int, int]:
        """Episodes and steps on disk."""
        return len(self._store), self._store.replay.steps

    def newest_keys(self, count: int) -> list[tuple[int, int]]:
        """The (plant boot id, episode) of the episodes that were stored last, oldest first."""
        return self._store.newest(count)

    @property
    def damage(self) -> tuple[int, int]:
        """Files at the start that were no episodes, and those that a dead writer had left half-written."""
        return len(self._store.corrupt), self._store.leftovers

    @property
    def untrained_episodes(self) -> int:
        """Episodes stored since the last finished update."""
        return len(self._store) - self._seen_episodes

    def store(self, episode: Episode) -> Stored | Unfit:
        """Write an episode; when this returns `Stored` it survives any crash. Raises OSError."""
        try:
            new = self._store.append(episode)
        except EpisodeRefused as error:
            return Unfit(str(error))
        self._newest = max(self._newest, episode.episode)
        return Stored(episode.boot_id, episode.episode, episode.mode, *self.stored, new)

    def train(self, begin: int | None = None) -> Trained:
        """Work off one slice; with `begin` first open an update of that many gradient steps."""
        if begin is not None:
            self._trainer.begin(self._store.replay, begin)
            self._seen_newest = self._newest
            self._seen_episodes = len(self._store)
        metrics = self._trainer.train_slice(self._store.replay)
        return self._trained(metrics) if self._trainer.remaining else self.finish(metrics)

    def finish(self, metrics: SliceMetrics = NO_STEPS) -> Trained:
        """Save the trainer, and return its model as a snapshot with errors on held-out episodes, if any."""
        snapshot = self._trainer.snapshot(self._seen_episodes)
        payload = snapshot.to_bytes()
        errors = self._trainer.evaluate_holdout(self._store.replay)
        self._save(payload)
        return replace(self._trained(metrics), snapshot_id=snapshot.id, payload=payload, errors=errors)

    def _trained(self, metrics: SliceMetrics) -> Trained:
        return Trained(
            metrics=metrics,
            total_updates=self._trainer.updates,
            remaining=self._trainer.remaining,
            after_episode=self._seen_newest,
            episodes=self._seen_episodes,
            steps=self._store.replay.steps,
        )

    def _save(self, payload: bytes) -> None:
        """Checkpoint before progress: a crash between the two repeats an update, it never skips one."""
        self._trainer.save(self._directory / CHECKPOINT)
        write_atomically(self._directory / SNAPSHOT, payload)
        progress = {"newest": self._seen_newest, "episodes": self._seen_episodes}
        write_atomically(self._directory / PROGRESS, json.dumps(progress).encode())

    def _resume(self) -> bool:
        """Continue from the checkpoint; an unusable one is left aside and training begins anew."""
        self._newest = self._store.newest_episode
        try:
            progress = json.loads((self._directory / PROGRESS).read_text())
            self._seen_newest, self._seen_episodes = int(progress["newest"]), int(progress["episodes"])
            self._trainer.load(self._directory / CHECKPOINT)
        except FileNotFoundError:
            self._seen_newest, self._seen_episodes = -1, 0
            return False
        except (TrainerStateRefused, OSError, ValueError, KeyError) as error:
            self._seen_newest, self._seen_episodes = -1, 0
            self.note = f"checkpoint refused, training from the stored episodes: {error}"
            return False
        return True

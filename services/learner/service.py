"""Learns while others act: stores every episode, acknowledges it, updates, publishes a snapshot."""

from __future__ import annotations

import math
from collections import Counter, deque

from common.bus import Inbox, Input, JobResult
from common.messages import WARMUP_MODES, Ack, Metrics, SnapshotMessage
from common.service import Job, Output, Publish, Report
from common.topics import ACK, METRICS, SNAPSHOT, STEP
from services.learner.config import LearnerConfig
from services.learner.episode import Episode
from services.learner.recorder import Recorder
from services.learner.trainer import SliceMetrics
from services.learner.worker import LearnerWorker, Stored, Trained, Unfit

RATE_WINDOW = 100
PERIOD_NS = 500_000_000
RETRY_NS = 2_000_000_000  # from a store or an update that failed to the next attempt
BACKLOG_UPDATES = 2  # updates that may be owed at once: newer data matters more than the number of steps
STATE_CHARS = 200
COUNTERS = (
    "updates",
    "snapshots",
    "refused_episodes",
    "repeated_episodes",
    "failed_stores",
    "failed_updates",
    "skipped_updates",
    "skipped_gradients",
    "nonfinite_figures",
)


class LearnerService:
    """State machine of the learner; everything slow happens in jobs."""

    name = "learner"
    inputs = (Input(STEP, wake=True),)
    period_ns: int | None = PERIOD_NS

    def __init__(self, config: LearnerConfig, warmup_steps: int, worker: LearnerWorker, boot_id: int) -> None:
        self._config = config
        self._warmup_steps = warmup_steps
        self._worker = worker
        self.boot_id = boot_id
        self._recorder = Recorder()
        self._episodes, self._steps = worker.stored
        self._trained_once = worker.resumed
        self._announce = worker.resumed  # a restarted learner tells at once what it knows
        self._reacknowledge = True  # its last acknowledgements may have died with it
        self._storing: deque[Episode] = deque()  # jobs are done in their order, so results come in this one
        self._unstored: deque[Episode] = deque()  # the disk refused them; each is tried again
        self._store_again_ns = 0
        self._store_error = ""
        self._training = False
        self._update = 0  # gradient steps of the update under way
        self._failed = 0  # and of one that failed and is to be begun anew
        self._owed = 0
        self._train_again_ns = 0
        self._train_error = worker.note
        self._update_ns = 0
        self._loss = 0.0
        self._gradient_norm = 0.0
        self._rates: deque[tuple[int, int]] = deque(maxlen=RATE_WINDOW)  # updates and ns of the last slices
        self._counts: Counter[str] = Counter()
        if worker.resumed:
            self._owe(worker.untrained_episodes)

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Record what the plant did, tell what is stored or learned, and go on training."""
        out: list[Output] = self._repeat_acks() if self._reacknowledge else []
        for result in inbox.results:
            self._take_result(result, now_ns, out)
        for sample in inbox.take(STEP):
            episode = self._recorder.add(sample.header, sample.message)
            if episode is not None:
                self._store(episode, out)
        if self._unstored and not self._storing and now_ns >= self._store_again_ns:
            self._store(self._unstored.popleft(), out)  # one alone shows whether there is room again
        self._train(now_ns, out)
        return out

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving: acknowledged episodes are on disk, and each update ends in a checkpoint."""
        return []

    def report(self) -> Report:
        """Counts since the start of the process."""
        corrupt, leftovers = self._worker.damage
        updates, spent = (sum(column) for column in zip(*self._rates, strict=True)) if self._rates else (0, 1)
        fields = {
            "stored_episodes": self._episodes,
            "stored_steps": self._steps,
            "corrupt_files": corrupt,
            "leftover_files": leftovers,
            "unstored_episodes": len(self._unstored),
            "updates_per_s": updates / max(spent, 1) * 1e9,
            "loss_total": self._loss,
            "gradient_norm": self._gradient_norm,
            "incomplete_episodes": self._recorder.incomplete,
        }
        fields |= {name: self._counts[name] for name in COUNTERS}
        return Report(self._state()[:STATE_CHARS], {key: float(value) for key, value in fields.items()})

    def _state(self) -> str:
        if self._store_error or self._train_error:
            return self._store_error or self._train_error
        if self._training:
            return "training"
        return "ready" if self._trained_once else f"collecting: {self._steps}/{self._warmup_steps} steps"

    def _repeat_acks(self) -> list[Output]:
        self._reacknowledge = False
        keys = self._worker.newest_keys(ACK.latched)
        return [Publish(ACK, Ack(*key, self._episodes, self._steps)) for key in keys]

    def _take_result(self, result: JobResult, now_ns: int, out: list[Output]) -> None:
        if result.name == "store":
            self._take_stored(result, now_ns, out)
        elif isinstance(result.value, Trained):
            self._take_trained(result.value, result.duration_ns, out)
        else:
            self._put_off(result, now_ns)

    # --- storing ----------------------------------------------------------------------------------

    def _store(self, episode: Episode, out: list[Output]) -> None:
        self._storing.append(episode)
        out.append(Job("store", self._worker.store, (episode,), self._ns(self._config.declared_store_ms)))

    def _take_stored(self, result: JobResult, now_ns: int, out: list[Output]) -> None:
        episode = self._storing.popleft()
        if isinstance(result.value, Stored):
            self._acknowledge(result.value, out)
            self._store_again_ns = now_ns
            self._store_error = self._store_error if self._unstored else ""
        elif isinstance(result.value, Unfit):
            self._counts["refused_episodes"] += 1
            self._store_error = f"episode refused: {result.value.reason}"
        else:
            self._counts["failed_stores"] += 1
            self._unstored.append(episode)
            self._store_again_ns = now_ns + RETRY_NS
            self._store_error = f"episode not stored, trying again: {result.error}"

    def _acknowledge(self, stored: Stored, out: list[Output]) -> None:
        self._episodes, self._steps = stored.episodes, stored.steps
        out.append(Publish(ACK, Ack(stored.boot_id, stored.episode, stored.episodes, stored.steps)))
        self._counts["repeated_episodes"] += not stored.new
        if stored.new and self._trained_once and stored.mode not in WARMUP_MODES:
            self._owe(1)

    # --- training ---------------------------------------------------------------------------------

    def _owe(self, episodes: int) -> None:
        """Add what `episodes` ask for to the backlog, and drop what is too much of it."""
        each = self._config.updates_per_episode
        owed = self._owed + max(0, episodes) * each  # negative where files of episodes have been lost
        self._owed = min(owed, BACKLOG_UPDATES * each)
        self._counts["skipped_updates"] += owed - self._owed

    def _put_off(self, result: JobResult, now_ns: int) -> None:
        """After a job that failed: whoever waits for its snapshot gets it from a later attempt."""
        self._training = False
        self._counts["failed_updates"] += 1
        self._train_again_ns = now_ns + RETRY_NS
        self._train_error = f"update failed, trying again: {result.error}"
        if result.name == "announce":
            self._announce = True
        else:
            self._failed = self._update

    def _take_trained(self, trained: Trained, duration_ns: int, out: list[Output]) -> None:
        self._training = False
        self._train_error = ""
        self._update_ns += duration_ns
        if trained.metrics.updates:
            self._count_slice(trained.metrics, duration_ns)
        if trained.remaining:
            self._submit("train", self._worker.train, (), out)
        else:
            self._publish(trained, out)

    def _count_slice(self, metrics: SliceMetrics, duration_ns: int) -> None:
        self._counts["updates"] += metrics.updates
        self._counts["skipped_gradients"] += metrics.skipped
        self._rates.append((metrics.updates, duration_ns))
        self._gradient_norm = metrics.gradient_norm
        loss = sum(metrics.loss.values())
        self._loss = loss if math.isfinite(loss) else self._loss  # a heartbeat with NaN would not be sent

    def _publish(self, trained: Trained, out: list[Output]) -> None:
        self._counts["snapshots"] += 1
        message = SnapshotMessage(trained.snapshot_id, trained.episodes, trained.payload)
        metrics = Metrics(
            after_episode=trained.after_episode,
            episodes=trained.episodes,
            steps=trained.steps,
            updates=trained.total_updates,
            snapshot_id=trained.snapshot_id,
            update_ms=self._update_ns / 1e6,
            loss=self._finite(trained.metrics.loss),
            holdout=self._finite(trained.errors.errors),
            calibration=self._finite(trained.errors.calibration | trained.errors.coverage),
        )
        self._update_ns = 0
        # The snapshot goes first: whoever waits for the metrics may count on the planner having been sent it.
        out += [Publish(SNAPSHOT, message), Publish(METRICS, metrics)]

    def _finite(self, figures: dict[str, float]) -> dict[str, float]:
        """Drop what the codec would refuse: `wait_for_update` waits for the message, not for its figures."""
        finite = {name: value for name, value in figures.items() if math.isfinite(value)}
        self._counts["nonfinite_figures"] += len(figures) - len(finite)
        return finite

    def _train(self, now_ns: int, out: list[Output]) -> None:
        """Open the next update if there is one: the first when the warm-up is stored, then per episode."""
        if self._training or now_ns < self._train_again_ns:
            return
        if self._announce:
            self._announce = False
            self._submit("announce", self._worker.finish, (), out)
        elif not self._trained_once and self._steps >= self._warmup_steps:
            self._trained_once = True
            self._begin(self._config.warmup_updates, out)
        elif self._failed:
            self._begin(self._failed, out)
        elif self._owed:
            self._owed -= self._config.updates_per_episode
            self._begin(self._config.updates_per_episode, out)

    def _begin(self, updates: int, out: list[Output]) -> None:
        self._update, self._failed = updates, 0
        self._submit("train", self._worker.train, (updates,), out)

    def _submit(self, name: str, function: object, arguments: tuple[int, ...], out: list[Output]) -> None:
        assert callable(function)
        self._training = True
        latency = self._ns(self._config.declared_update_ms * self._config.slice_updates)
        out.append(Job(name, function, arguments, latency))

    @staticmethod
    def _ns(milliseconds: float) -> int:
        return round(milliseconds * 1e6)

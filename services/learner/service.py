"""Learns while others act: stores every episode, acknowledges it, updates, publishes a snapshot."""

from __future__ import annotations

from collections import Counter, deque

from common.bus import Inbox, Input, JobResult
from common.messages import Ack, Metrics, Mode, SnapshotMessage
from common.service import Job, Output, Publish, Report
from common.topics import ACK, METRICS, SNAPSHOT, STEP
from services.learner.config import LearnerConfig
from services.learner.recorder import Recorder
from services.learner.worker import LearnerWorker, Stored, Trained

RATE_WINDOW = 100


class LearnerService:
    """State machine of the learner; everything slow happens in jobs."""

    name = "learner"
    inputs = (Input(STEP, wake=True),)
    period_ns: int | None = None

    def __init__(self, config: LearnerConfig, warmup_steps: int, worker: LearnerWorker, boot_id: int) -> None:
        self._config = config
        self._warmup_steps = warmup_steps
        self._worker = worker
        self.boot_id = boot_id
        self._recorder = Recorder()
        self._episodes, self._steps = worker.stored
        self._trained_once = worker.resumed
        self._owed = worker.untrained_episodes * config.updates_per_episode if worker.resumed else 0
        self._announce = worker.resumed  # a restarted learner tells at once what it knows
        self._reacknowledge = True  # its last acknowledgements may have died with it
        self._training = False
        self._update = 0  # gradient steps of the update under way
        self._failed = 0  # and of one that failed, which the next episode tries again
        self._update_ns = 0
        self._loss = 0.0
        self._rates: deque[tuple[int, int]] = deque(maxlen=RATE_WINDOW)  # updates and ns of the last slices
        self._counts: Counter[str] = Counter()
        self._last_error = worker.note

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Record what the plant did, tell what is stored or learned, and go on training."""
        out: list[Output] = self._repeat_acks() if self._reacknowledge else []
        for result in inbox.results:
            self._take_result(result, out)
        for sample in inbox.take(STEP):
            episode = self._recorder.add(sample.header, sample.message)
            if episode is not None:
                out.append(
                    Job("store", self._worker.store, (episode,), self._ns(self._config.declared_store_ms))
                )
        self._train(out)
        return out

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving: acknowledged episodes are on disk, and each update ends in a checkpoint."""
        return []

    def report(self) -> Report:
        """Counts since the start of the process."""
        updates, spent = (sum(column) for column in zip(*self._rates, strict=True)) if self._rates else (0, 1)
        fields = {
            "stored_episodes": self._episodes,
            "stored_steps": self._steps,
            "updates": self._counts["updates"],
            "updates_per_s": updates / max(spent, 1) * 1e9,
            "loss_total": self._loss,
            "snapshots": self._counts["snapshots"],
            "refused_episodes": self._counts["refused_episodes"],
            "incomplete_episodes": self._recorder.incomplete,
            "failed_updates": self._counts["failed_updates"],
        }
        return Report(self._state(), {key: float(value) for key, value in fields.items()})

    def _state(self) -> str:
        if self._last_error:
            return self._last_error
        if self._training:
            return "training"
        return "ready" if self._trained_once else f"collecting: {self._steps}/{self._warmup_steps} steps"

    def _repeat_acks(self) -> list[Output]:
        self._reacknowledge = False
        keys = self._worker.newest_keys(ACK.latched)
        return [Publish(ACK, Ack(*key, self._episodes, self._steps)) for key in keys]

    def _take_result(self, result: JobResult, out: list[Output]) -> None:
        if result.name == "store":
            self._take_stored(result, out)
        else:
            self._take_trained(result, out)

    def _take_stored(self, result: JobResult, out: list[Output]) -> None:
        if not isinstance(result.value, Stored):
            self._counts["refused_episodes"] += 1
            self._last_error = f"episode not stored: {result.error}"
            return
        stored = result.value
        self._episodes, self._steps = stored.episodes, stored.steps
        out.append(Publish(ACK, Ack(stored.boot_id, stored.episode, stored.episodes, stored.steps)))
        if stored.new and self._trained_once and stored.mode != Mode.RANDOM:
            self._owed += self._config.updates_per_episode
        self._owed, self._failed = self._owed + self._failed, 0

    def _take_trained(self, result: JobResult, out: list[Output]) -> None:
        self._training = False
        if not isinstance(result.value, Trained):
            self._counts["failed_updates"] += 1
            self._failed = self._update  # repeating it at once would fail for ever
            self._last_error = f"update failed: {result.error}"
            return
        trained = result.value
        self._last_error = ""
        self._counts["updates"] += trained.updates
        self._update_ns += result.duration_ns
        if trained.updates:
            self._rates.append((trained.updates, result.duration_ns))
            self._loss = sum(trained.loss.values())
        if trained.remaining:
            self._continue(out)
        elif trained.payload:
            self._publish(trained, out)

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
            loss=trained.loss,
            holdout=trained.errors.errors,
            calibration=trained.errors.calibration | trained.errors.coverage,
        )
        self._update_ns = 0
        # The snapshot goes first: whoever waits for the metrics may count on the planner having been sent it.
        out += [Publish(SNAPSHOT, message), Publish(METRICS, metrics)]

    def _train(self, out: list[Output]) -> None:
        """Open the next update if there is one: the first when the warm-up is stored, then per episode."""
        if self._training:
            return
        if self._announce:
            self._announce = False
            self._submit("announce", self._worker.finish, (), out)
        elif not self._trained_once and self._steps >= self._warmup_steps:
            self._trained_once = True
            self._begin(self._config.warmup_updates, out)
        elif self._owed:
            owed, self._owed = self._owed, 0
            self._begin(owed, out)

    def _begin(self, updates: int, out: list[Output]) -> None:
        self._update = updates
        self._submit("train", self._worker.train, (updates,), out)

    def _continue(self, out: list[Output]) -> None:
        self._submit("train", self._worker.train, (0,), out)

    def _submit(self, name: str, function: object, arguments: tuple[int, ...], out: list[Output]) -> None:
        assert callable(function)
        self._training = True
        latency = self._ns(self._config.declared_update_ms * self._config.slice_updates)
        out.append(Job(name, function, arguments, latency))

    @staticmethod
    def _ns(milliseconds: float) -> int:
        return round(milliseconds * 1e6)

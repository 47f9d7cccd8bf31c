"""The operator's side of a run: sequences warm-up, goals and evaluations, scores and records every episode.

The only publisher of `task/episode`. An episode's id is on disk before it is published and its result before
the next one is, so that the run goes on where it was after any crash.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from common.built import Built
from common.bus import Inbox, Input, JobResult
from common.messages import WARMUP_MODES, Ack, Episode, Metrics, Mode, Sample, Warmup
from common.service import Finish, Job, Output, Publish, Report
from common.task import Task, get_task
from common.topics import ACK, CHUNK, EPISODE, METRICS, STEP
from deploy import schedule
from deploy.curriculum_config import CurriculumProcess
from deploy.curriculum_files import CurriculumFiles
from deploy.goals import goal_of
from deploy.schedule import Assignment, Done, Pending, Waiting
from deploy.scores import EpisodeTrace, Row, Scoreboard, row_of

PERIOD_NS = 250_000_000
RETRY_NS = 5_000_000_000  # after a failed write, for instance on a full disk
ACKS_KEPT = 64


class CurriculumService:
    """State machine; `labels` stand in every row of the results."""

    name = "curriculum"
    inputs = (
        Input(STEP, wake=True),
        Input(CHUNK),
        Input(ACK, wake=True),
        Input(METRICS, newest=True, wake=True),
    )

    def __init__(
        self,
        config: CurriculumProcess,
        task: Task,
        files: CurriculumFiles,
        boot_id: int,
        labels: Mapping[str, Any],
    ) -> None:
        """Take up the run where it was. Raises ConfigError if the files belong to another run."""
        self.boot_id = boot_id
        self.period_ns: int | None = PERIOD_NS
        self._config = config
        self._task = task
        self._files = files
        self._labels = labels
        self._board = Scoreboard()
        self._progress, rows = files.load()
        for row in rows:
            self._board.add(row)
        self._forget_idle()
        self._trace: EpisodeTrace | None = None
        self._watch_assigned()
        self._saved_id = self._progress.next_id
        self._rows: list[Row] = []  # finished but not on disk yet
        self._saving: tuple[int, int] | None = None  # next id and number of rows of the write under way
        self._retry_ns = 0
        self._error = ""
        self._waiting = ""
        self._published = -1
        self._begun_ns = 0  # when the running episode was published
        self._goals_begun_ns = -1  # when the first planned episode of this process was
        self._goals_ended = 0
        self._now_ns = 0
        self._acks: deque[int] = deque(maxlen=ACKS_KEPT)  # episodes, of whichever of the plant's tries
        self._deadlines_ns: dict[int, int] = {}
        self._done = False

    def _forget_idle(self) -> None:
        """A finished run that was given more episodes goes on; one that was not ends again."""
        assigned = self._progress.assigned
        if assigned is not None and assigned.mode is Mode.IDLE:
            self._progress = self._progress.model_copy(update={"assigned": None})

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Follow the running episode, account for what has ended, and begin what is next."""
        self._now_ns = now_ns
        for result in inbox.results:
            self._take_result(result)
        for sample in inbox.take(CHUNK):
            if self._trace:
                self._trace.add_chunk(sample)
        for sample in inbox.take(STEP):
            self._take_step(sample)
        for sample in inbox.take(ACK):
            self._take_ack(sample.message)
        for sample in inbox.take(METRICS):
            self._take_metrics(sample.message)
        for pending in self._progress.pending:
            self._resolve(pending)
        return self._advance()

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing is left to save: all that counts is on disk already."""
        return []

    def report(self) -> Report:
        """Where the run is, what it waits for, and how it goes."""
        progress = self._progress
        assigned = progress.assigned
        fields = {
            "episode": float(assigned.episode if assigned else progress.next_id - 1),
            "episodes_total": float(schedule.episodes_total(progress, self._config)),
            "training_episodes_done": float(progress.trained),
            "lost_episodes": float(progress.lost),
            "done": float(self._done),
        }
        return Report(self._state(), fields | self._board.fields() | self._eta())

    def _state(self) -> str:
        if self._error:
            return self._error
        assigned = self._progress.assigned
        if assigned is None or self._trace is None:
            return "done" if self._done else self._waiting
        if self._trace.k < 0:
            return "waiting for the plant"
        if self._trace.waiting:
            return "waiting for the planner"
        return f"{self._where(assigned)}: step {self._trace.k} of {self._config.curriculum.episode_steps}"

    def _where(self, assigned: Assignment) -> str:
        plan = self._config.curriculum
        if assigned.mode in WARMUP_MODES:
            return f"warm-up, {self._progress.warmup_steps} of {self._config.warmup_steps} steps done"
        if assigned.mode is Mode.PLAN:
            return f"training {assigned.index + 1} of {plan.episodes}"
        return f"evaluation, goal {assigned.index + 1} of {plan.evaluate_goals}"

    def _eta(self) -> dict[str, float]:
        if not self._goals_ended:
            return {}
        each_s = (self._now_ns - self._goals_begun_ns) / 1e9 / self._goals_ended
        return {"eta_s": each_s * schedule.planned_left(self._progress, self._config)}

    # --- what others say --------------------------------------------------------------------------

    def _take_step(self, sample: Sample) -> None:
        if self._trace is None or sample.message.episode != self._trace.episode:
            return
        if self._trace.add(sample):
            self._end_episode(self._trace)

    def _end_episode(self, trace: EpisodeTrace) -> None:
        assigned = self._progress.assigned
        assert assigned is not None
        row = row_of(
            self._labels,
            trace.score(self._task),
            episode=assigned.episode,
            mode=assigned.mode.value,
            index=assigned.index,
            episode_seed=assigned.seed,
            trained_episodes=self._progress.trained,
            t_ns=self._now_ns,
            duration_s=round((self._now_ns - self._begun_ns) / 1e9, 3),
        )
        self._rows.append(row)
        self._board.add(row)
        self._goals_ended += assigned.mode not in WARMUP_MODES
        self._progress = schedule.finish(self._progress, row["steps"], self._config)
        self._trace = None

    def _take_ack(self, ack: Ack) -> None:
        self._acks.append(ack.episode)
        # An ack that nobody heard shows in the count of a later one.
        if ack.stored_episodes >= schedule.stored_by(self._progress, ack.episode):
            older = (item.episode for item in self._progress.pending if item.episode < ack.episode)
            self._acks.extend(older)

    def _take_metrics(self, metrics: Metrics) -> None:
        newest = max(self._progress.updated_after, metrics.after_episode)
        self._progress = self._progress.model_copy(update={"updated_after": newest})

    def _resolve(self, pending: Pending) -> None:
        """Settle a finished episode: acknowledged, or lost for good."""
        timeout_ns = round(self._config.curriculum.ack_timeout_s * 1e9)
        deadline_ns = self._deadlines_ns.setdefault(pending.episode, self._now_ns + timeout_ns)
        # A learner that died between storing and telling has the episode in its next update.
        seen = self._progress.updated_after == pending.episode
        if seen or pending.episode in self._acks:
            self._progress = schedule.acknowledge(self._progress, pending)
        elif self._now_ns >= deadline_ns:
            self._progress = schedule.lose(self._progress, pending)
        else:
            return
        del self._deadlines_ns[pending.episode]

    def _take_result(self, result: JobResult) -> None:
        assert self._saving is not None
        saved_id, rows = self._saving
        self._saving = None
        self._error = f"cannot write results: {result.error}" if result.error else ""
        if result.error:
            self._retry_ns = self._now_ns + RETRY_NS
            return
        self._saved_id = saved_id
        del self._rows[:rows]

    # --- what is next -----------------------------------------------------------------------------

    def _advance(self) -> list[Output]:
        if self._saving is not None or self._now_ns < self._retry_ns:
            return []
        if self._progress.assigned is None:
            self._choose()
        if self._rows or self._saved_id != self._progress.next_id:
            self._saving = (self._progress.next_id, len(self._rows))
            return [Job("commit", self._files.commit, (self._progress, tuple(self._rows)))]
        return self._announce()

    def _choose(self) -> None:
        chosen = schedule.decide(self._progress, self._config)
        self._waiting = chosen.reason if isinstance(chosen, Waiting) else ""
        if isinstance(chosen, Waiting):
            return
        if isinstance(chosen, Done):
            chosen = schedule.idle(self._progress)
        self._progress = schedule.assign(self._progress, chosen)
        self._watch_assigned()

    def _watch_assigned(self) -> None:
        assigned = self._progress.assigned
        if assigned is not None and assigned.mode is not Mode.IDLE:
            x = self._config.control.steps_per_plan
            self._trace = EpisodeTrace(assigned.episode, x if isinstance(x, int) else None)

    def _announce(self) -> list[Output]:
        assigned = self._progress.assigned
        if assigned is None or assigned.episode == self._published:
            return []
        self._published = assigned.episode
        self._begun_ns = self._now_ns
        outputs: list[Output] = [Publish(EPISODE, self._message(assigned))]
        if assigned.mode is Mode.IDLE:
            self._done = True
            outputs.append(Finish(0))
        elif assigned.mode not in WARMUP_MODES and self._goals_begun_ns < 0:
            self._goals_begun_ns = self._now_ns
        return outputs

    def _message(self, assigned: Assignment) -> Episode:
        random = assigned.mode is Mode.RANDOM
        return Episode(
            episode=assigned.episode,
            goal_seq=0,
            goal=goal_of(self._task, assigned, self._config.curriculum),
            mode=assigned.mode,
            warmup=Warmup(self._config.curriculum.warmup) if random else Warmup.NONE,
            steps=0 if assigned.mode is Mode.IDLE else self._config.curriculum.episode_steps,
            seed=assigned.seed,
        )


def build(config: CurriculumProcess, boot_id: int, labels: Mapping[str, Any] | None = None) -> Built:
    """Make the service; `labels` are added to every row. Raises ConfigError if run_dir is another run's."""
    files = CurriculumFiles(config.run_dir, config.task, config.seed)
    own = {"task": config.task, "seed": config.seed, "config_hash": config.config_hash}
    service = CurriculumService(config, get_task(config.task), files, boot_id, {**own, **(labels or {})})
    return Built(service)


if __name__ == "__main__":
    from common.process import run_process  # brings the bus with it, which lock-step runs do without

    run_process("curriculum", CurriculumProcess, build)

"""The plant's side of the control loop: runs episodes on its own clock, whatever the planner does."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from common.bus import Inbox, Input
from common.cell import ControlConfig, SharedConfig
from common.executor import ActionBuffer, Executed
from common.messages import (
    Ack,
    Chunk,
    Episode,
    Fallback,
    Float32,
    Mode,
    PlantCommand,
    PlantFrame,
    Sample,
    Step,
    Warmup,
)
from common.service import Output, Publish, Report, ToPort
from common.task import Task
from common.topics import ACK, CHUNK, EPISODE, PLANT_COMMAND, PLANT_FRAME, STEP
from services.sim.warmup import WarmupActions


class Phase(StrEnum):
    """Where the plant is within an episode."""

    IDLE = "waiting for an episode"
    RESETTING = "resetting"
    WAITING = "waiting for the planner"  # standing still until a plan covers the present step
    RUNNING = "running"
    DONE = "episode finished"


_EMPTY: Float32 = np.zeros(0, np.float32)
ROUND_TRIPS = 16_384  # plans that the reported delays are taken over


@dataclass(frozen=True)
class _Previous:
    """The action executed before the present step."""

    executed: Executed

    @staticmethod
    def none(action_dim: int) -> _Previous:
        return _Previous(Executed(np.zeros(action_dim, np.float32), -1, -1, Fallback.NONE, False))


class _RoundTrips:
    """How long plans took on the plant's own clock, from the step that they start from to their arrival."""

    def __init__(self) -> None:
        self._ms = np.zeros((2, ROUND_TRIPS), np.float32)  # (age and overhead, newest plans)
        self._count = 0

    def add(self, age_ms: float, solve_ms: float) -> None:
        """Note one plan; its overhead is what was not solving: encoding, transport, waiting."""
        self._ms[:, self._count % ROUND_TRIPS] = age_ms, age_ms - solve_ms
        self._count += 1

    def fields(self) -> dict[str, float]:
        """Quantiles in ms, for the heartbeat; none before the first plan."""
        if not self._count:
            return {}
        ordered = np.sort(self._ms[:, : self._count], axis=1)  # a tenth of what np.percentile takes
        ranks = {"p50": 0.5, "p99": 0.99, "max": 1.0}
        return {
            f"{what}_ms_{name}": float(row[round(rank * (len(row) - 1))])
            for what, row in zip(("plan_age", "overhead"), ordered, strict=True)
            for name, rank in ranks.items()
        }


class SimService:
    """State machine of a simulated hand: never waits for anybody while an episode runs.

    Only `start: plan` (before step 0) and synchronous control (at every step) make it stand still until a
    plan arrives. Random episodes run as fast as the device answers; all others at the control rate.
    """

    name = "sim"
    inputs = (
        Input(EPISODE, newest=True, wake=True),
        Input(CHUNK, wake=True),
        Input(ACK),
        Input(PLANT_FRAME, wake=True),
    )

    def __init__(self, config: SharedConfig, task: Task, boot_id: int) -> None:
        self._task = task
        self._control: ControlConfig = config.control
        self.boot_id = boot_id
        self.period_ns: int | None = config.control.period_ns
        x = config.control.steps_per_plan
        start_steps = x if config.control.start == "zero" and isinstance(x, int) else 0
        self._buffer = ActionBuffer(task.action_dim, start_steps, config.control.hold_steps)
        self._phase = Phase.IDLE
        self._episode: Episode | None = None
        self._frame: PlantFrame | None = None
        self._k = 0
        self._announced = -1  # step that was published as waiting
        self._previous = _Previous.none(task.action_dim)
        self._warmup: WarmupActions | None = None
        self._unacknowledged: set[int] = set()
        self._counts: Counter[str] = Counter()
        self._round_trips = _RoundTrips()

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Take over frames, episodes and chunks, then move on if it is time to."""
        out: list[Output] = []
        frames = inbox.take(PLANT_FRAME)
        for sample in frames:
            self._take_frame(sample.message)
        for sample in inbox.take(ACK):
            self._take_ack(sample.message)
        for sample in inbox.take(EPISODE):
            self._take_episode(sample.message, out)
        for sample in inbox.take(CHUNK):
            self._take_chunk(sample, now_ns)
        self._advance(inbox.ticks, bool(frames), out)
        return out

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving: an unfinished episode is run again after the restart."""
        return []

    def report(self) -> Report:
        """Counts since the start of the process."""
        counts = self._buffer.counts
        refused = {f"refused_{reason.replace(' ', '_')}": n for reason, n in self._buffer.refused.items()}
        numbers = {
            "episode": self._episode.episode if self._episode else -1,
            "k": self._k,
            "control_steps": self._counts["control_steps"],
            "missed_ticks": self._counts["missed_ticks"],
            "late_steps": counts["late"],
            "held_steps": counts["hold"] + counts["relax"],
            "refused_chunks": sum(self._buffer.refused.values()),
            "abandoned_episodes": self._counts["abandoned"],
            "refused_episodes": self._counts["refused_episodes"],
            "unacknowledged": len(self._unacknowledged),
            "warmup_steps": self._counts["warmup_steps"],
        }
        counted = {key: float(n) for key, n in (numbers | refused).items()}
        return Report(self._phase.value, counted | self._round_trips.fields())

    def _take_frame(self, frame: PlantFrame) -> None:
        self._frame = frame
        if frame.reset and self._phase is Phase.RESETTING and self._episode:
            planned = self._episode.mode is not Mode.RANDOM and self._control.start == "plan"
            self._phase = Phase.WAITING if planned or self._waits_always() else Phase.RUNNING

    def _waits_always(self) -> bool:
        return (
            self._control.synchronous and self._episode is not None and self._episode.mode is not Mode.RANDOM
        )

    def _take_ack(self, ack: Ack) -> None:
        if ack.plant_boot_id == self.boot_id:
            self._unacknowledged.discard(ack.episode)

    def _take_episode(self, episode: Episode, out: list[Output]) -> None:
        if episode.goal.size not in (0, self._task.goal_dim):
            self._counts["refused_episodes"] += 1
            return
        current = self._episode
        if current is not None and episode.episode == current.episode:
            if episode.goal_seq > current.goal_seq:
                self._change_goal(episode, out)
            return
        if self._phase in (Phase.RUNNING, Phase.WAITING, Phase.RESETTING):
            self._counts["abandoned"] += 1
        self._episode = episode
        if episode.mode is Mode.IDLE:
            self._phase = Phase.IDLE
            return
        self._begin(episode, out)

    def _begin(self, episode: Episode, out: list[Output]) -> None:
        self._phase = Phase.RESETTING
        self._k = 0
        self._announced = -1
        self._previous = _Previous.none(self._task.action_dim)
        self._buffer.reset(self.boot_id, episode.episode, episode.goal_seq)
        if episode.mode is Mode.RANDOM:
            kind = "mix" if episode.warmup is Warmup.MIX else "uniform"
            self._warmup = WarmupActions(kind, self._task.action_dim, episode.seed, episode.episode)
        out.append(self._command(reset=True, seed=episode.seed, goal=episode.goal))

    def _change_goal(self, episode: Episode, out: list[Output]) -> None:
        self._episode = episode
        self._buffer.change_goal(self.boot_id, episode.episode, episode.goal_seq)
        if not episode.goal.size:
            return
        if self._frame is not None:
            self._frame = replace(self._frame, goal=episode.goal)
        out.append(self._command(goal=episode.goal))

    def _take_chunk(self, sample: Sample, now_ns: int) -> None:
        chunk: Chunk = sample.message
        refused = self._buffer.offer(chunk, sample.header.seq, self._k, sample.header.boot_id)
        if not refused and chunk.first_k > chunk.source_k:  # made while the plant moved
            self._round_trips.add((now_ns - chunk.source_t_ns) / 1e6, chunk.solve_ms)

    def _advance(self, ticks: int, framed: bool, out: list[Output]) -> None:
        if self._episode is None or self._frame is None:
            return
        if self._phase is Phase.RUNNING and self._episode.mode is Mode.RANDOM:
            if framed:
                self._random_step(out)
        elif self._phase is Phase.WAITING:
            self._wait(ticks, out)
        elif self._phase is Phase.RUNNING and ticks:
            self._counts["missed_ticks"] += ticks - 1
            self._planned_step(out)

    def _random_step(self, out: list[Output]) -> None:
        assert self._warmup is not None
        self._counts["warmup_steps"] += 1
        self._publish_step(out, waiting=False)
        if self._phase is Phase.RUNNING:
            action = next(self._warmup)
            self._execute(Executed(action, -1, -1, Fallback.NONE, False), out)

    def _wait(self, ticks: int, out: list[Output]) -> None:
        if self._announced < self._k:
            self._announced = self._k
            self._publish_step(out, waiting=True)
        elif self._planned() and (ticks or self._control.synchronous):
            self._phase = Phase.RUNNING
            self._planned_step(out)

    def _planned(self) -> bool:
        """Whether the present step may be executed; synchronous control never runs down a tail."""
        return self._buffer.covers(self._k, committed=self._control.synchronous)

    def _planned_step(self, out: list[Output]) -> None:
        self._publish_step(out, waiting=False)
        if self._phase is not Phase.RUNNING:
            return
        self._counts["control_steps"] += 1
        self._execute(self._buffer.take(self._k), out)
        if self._waits_always() and not self._planned():
            self._phase = Phase.WAITING

    def _execute(self, executed: Executed, out: list[Output]) -> None:
        self._previous = _Previous(executed)
        self._k += 1
        out.append(self._command(action=executed.action))

    def _publish_step(self, out: list[Output], waiting: bool) -> None:
        """Publish the present step; the last one ends the episode."""
        assert self._episode is not None and self._frame is not None
        last = self._k >= self._episode.steps
        waits = waiting and not last  # nothing is wanted any more
        out.append(Publish(STEP, self._step_message(self._episode, self._frame, waits, last)))
        if last:
            self._phase = Phase.DONE
            if self._episode.mode is not Mode.EVALUATE:
                self._unacknowledged.add(self._episode.episode)

    def _step_message(self, episode: Episode, frame: PlantFrame, waiting: bool, last: bool) -> Step:
        executed = self._previous.executed
        return Step(
            episode=episode.episode,
            goal_seq=episode.goal_seq,
            k=self._k,
            steps=episode.steps,
            mode=episode.mode,
            state=frame.state,
            part_valid=np.ones(len(self._task.groups), np.uint8),
            prev_action=executed.action,
            goal=frame.goal,
            chunk_seq=executed.chunk_seq,
            chunk_offset=executed.chunk_offset,
            fallback=executed.fallback,
            first=self._k == 0,
            last=last,
            waiting=waiting,
            dropped=frame.dropped,
        )

    def _command(
        self, reset: bool = False, seed: int = 0, goal: Float32 = _EMPTY, action: Float32 = _EMPTY
    ) -> ToPort:
        return ToPort("plant", PLANT_COMMAND, PlantCommand(reset, seed, goal, action))

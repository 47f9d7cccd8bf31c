"""The plant's side of the control loop: runs episodes on its own clock, whatever the planner does.

Simulated and real hand share it, so that nobody can tell from `control/step` which of them is there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from common.cell import ControlConfig
from common.demonstrations import Demonstrations
from common.executor import ActionBuffer, Executed
from common.messages import WARMUP_MODES, Ack, Chunk, Episode, Fallback, Float32, Mode, Sample, Step, UInt8
from common.round_trips import RoundTrips
from common.service import Output, Publish
from common.task import Task
from common.topics import STEP
from common.warmup import warmup_script


class Phase(StrEnum):
    """Where the plant is within an episode."""

    IDLE = "waiting for an episode"
    RESETTING = "resetting"
    WAITING = "waiting for the planner"  # standing still until a plan covers the present step
    RUNNING = "running"
    DONE = "episode finished"


ANNOUNCE_S = 0.5  # how often a plant that stands still asks for a plan
ACTIVE = (Phase.RUNNING, Phase.WAITING, Phase.RESETTING)


@dataclass(frozen=True)
class Seen:
    """What the hand shows: state (S,), validity and age per part (V,), goal (G,).

    `executed` (A,) replaces the action that was asked for where it is not NaN: the hand did something else.
    """

    state: Float32
    part_valid: UInt8
    part_age_ms: Float32
    goal: Float32
    dropped: bool
    executed: Float32 | None = None


class Hand(Protocol):
    """What moves: each call returns what it takes to make it happen."""

    def reset(self, seed: int, goal: Float32) -> list[Output]:
        """Begin anew towards `goal` (G,), or towards that of `seed` if it is empty."""
        ...

    def pursue(self, goal: Float32) -> list[Output]:
        """Show `goal` (G,) from now on."""
        ...

    def act(self, executed: Executed) -> list[Output]:
        """Execute an action for one control step."""
        ...


class PlantLoop:
    """State machine of a plant's episodes: never waits for anybody while one runs.

    Only `start: plan` (before step 0) and synchronous control (at every step) make it stand still until a
    plan arrives. `demonstrations` are what `glove` episodes replay; without any those are refused.
    """

    def __init__(
        self,
        control: ControlConfig,
        task: Task,
        boot_id: int,
        hand: Hand,
        demonstrations: Demonstrations | None = None,
    ) -> None:
        self._task = task
        self._demonstrations = demonstrations
        self._control = control
        self._hand = hand
        self.boot_id = boot_id
        x = control.steps_per_plan
        start_steps = x if control.start == "zero" and isinstance(x, int) else 0
        self._buffer = ActionBuffer(task.action_dim, start_steps, control.hold_steps)
        self.phase = Phase.IDLE
        self.episode: Episode | None = None
        self._seen: Seen | None = None
        self._k = 0
        self._announced = -1  # step that was published as waiting
        self._silent_ticks = 0  # since then
        self._patience_ticks = max(1, round(ANNOUNCE_S * control.rate_hz))
        self._nothing = Executed(np.zeros(task.action_dim, np.float32), -1, -1, Fallback.NONE, False)
        self._previous = self._nothing  # executed before the present step
        self._script: Iterator[Float32] = iter(())  # actions of a warm-up episode
        self._unacknowledged: set[int] = set()  # episodes
        self._counts: Counter[str] = Counter()
        self._round_trips = RoundTrips()

    def fields(self) -> dict[str, float]:
        """Counts since the start of the process."""
        counts = self._buffer.counts
        refused = {f"refused_{reason.replace(' ', '_')}": n for reason, n in self._buffer.refused.items()}
        numbers = {
            "episode": self.episode.episode if self.episode else -1,
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
            "glove_samples": self._demonstrations.samples if self._demonstrations else 0,
        }
        counted = {key: float(n) for key, n in (numbers | refused).items()}
        return counted | self._round_trips.fields()

    def see(self, seen: Seen) -> None:
        """Take over what the hand shows now."""
        self._seen = seen

    def has_reset(self) -> None:
        """The hand that was told to reset stands ready, as last seen."""
        if self.phase is Phase.RESETTING and self.episode:
            waits = self._planned_mode() and (self._control.start == "plan" or self._control.synchronous)
            self.phase = Phase.WAITING if waits else Phase.RUNNING

    def _planned_mode(self) -> bool:
        return self.episode is not None and self.episode.mode not in WARMUP_MODES

    def take_ack(self, ack: Ack) -> None:
        """An episode is on disk, be it from an earlier life of this plant."""
        self._unacknowledged.discard(ack.episode)

    def take_episode(self, episode: Episode) -> list[Output]:
        """Begin an episode, change the goal of the present one, or stop for `idle`."""
        unknown = episode.mode is Mode.GLOVE and self._demonstrations is None
        if unknown or episode.goal.size not in (0, self._task.goal_dim):
            self._counts["refused_episodes"] += 1
            return []
        current = self.episode
        if current is not None and episode.episode == current.episode:
            return self._change_goal(episode) if episode.goal_seq > current.goal_seq else []
        self._counts["abandoned"] += self.phase in ACTIVE
        self.episode = episode
        if episode.mode is Mode.IDLE:
            self.phase = Phase.IDLE
            return []
        return self._begin(episode)

    def abandon(self) -> bool:
        """Stop within an episode, if there is one; the same may begin again, as that of another boot.

        Nobody joins its steps with those of the first try then.
        """
        if self.phase not in ACTIVE:
            return False
        self._counts["abandoned"] += 1
        self.phase = Phase.IDLE
        self.episode = None
        self.boot_id += 1
        return True

    def _begin(self, episode: Episode) -> list[Output]:
        self.phase = Phase.RESETTING
        self._k = 0
        self._announced = -1
        self._previous = self._nothing
        self._buffer.reset(self.boot_id, episode.episode, episode.goal_seq)
        self._script = warmup_script(episode, self._task.action_dim, self._demonstrations)
        return self._hand.reset(episode.seed, episode.goal)

    def _change_goal(self, episode: Episode) -> list[Output]:
        self.episode = episode
        self._announced = -1  # a plant that waits asks anew, for a plan to the new goal
        self._buffer.change_goal(self.boot_id, episode.episode, episode.goal_seq)
        if not episode.goal.size:
            return []
        if self._seen is not None:
            self._seen = replace(self._seen, goal=episode.goal)
        return self._hand.pursue(episode.goal)

    def take_chunk(self, sample: Sample, now_ns: int) -> None:
        """Take over what is still of use of a plan."""
        chunk: Chunk = sample.message
        refused = self._buffer.offer(chunk, sample.header.seq, self._k, sample.header.boot_id)
        if not refused and chunk.first_k > chunk.source_k:  # made while the plant moved
            self._round_trips.add((now_ns - chunk.source_t_ns) / 1e6, chunk.solve_ms)

    def advance(self, ticks: int, warmup_due: bool) -> list[Output]:
        """Move on if it is time to: at a tick, or with an action of the warm-up when `warmup_due`."""
        if self.episode is None or self._seen is None:
            return []
        if self.phase is Phase.RUNNING and not self._planned_mode():
            return self._warmup_step() if warmup_due else []
        if self.phase is Phase.WAITING:
            return self._wait(ticks)
        if self.phase is Phase.RUNNING and ticks:
            self._counts["missed_ticks"] += ticks - 1
            return self._planned_step()
        return []

    def _warmup_step(self) -> list[Output]:
        self._counts["warmup_steps"] += 1
        out = self._publish_step(waiting=False)
        if self.phase is Phase.RUNNING:
            out += self._execute(Executed(next(self._script), -1, -1, Fallback.NONE, False))
        return out

    def _wait(self, ticks: int) -> list[Output]:
        self._silent_ticks += ticks
        lost = not self._planned() and self._silent_ticks >= self._patience_ticks
        if self._announced < self._k or lost:  # the step, or the plan for it, may have got lost
            self._announced, self._silent_ticks = self._k, 0
            return self._publish_step(waiting=True)
        if self._planned() and (ticks or self._control.synchronous):
            self.phase = Phase.RUNNING
            return self._planned_step()
        return []

    def _planned(self) -> bool:
        """Whether the present step may be executed; synchronous control never runs down a tail."""
        return self._buffer.covers(self._k, committed=self._control.synchronous)

    def _planned_step(self) -> list[Output]:
        out = self._publish_step(waiting=False)
        if self.phase is not Phase.RUNNING:
            return out
        self._counts["control_steps"] += 1
        out += self._execute(self._buffer.take(self._k))
        if self._control.synchronous and self._planned_mode() and not self._planned():
            self.phase = Phase.WAITING
        return out

    def _execute(self, executed: Executed) -> list[Output]:
        self._previous = executed
        self._k += 1
        return self._hand.act(executed)

    def _publish_step(self, waiting: bool) -> list[Output]:
        """Publish the present step; the last one ends the episode."""
        assert self.episode is not None and self._seen is not None
        last = self._k >= self.episode.steps
        waits = waiting and not last  # nothing is wanted any more
        step = self._step_message(self.episode, self._seen, waits, last)
        if last:
            self.phase = Phase.DONE
            if self.episode.mode is not Mode.EVALUATE:
                self._unacknowledged.add(self.episode.episode)
        return [Publish(STEP, step)]

    def _step_message(self, episode: Episode, seen: Seen, waiting: bool, last: bool) -> Step:
        executed = self._previous
        action = executed.action
        if seen.executed is not None and self._k:
            action = np.where(np.isnan(seen.executed), action, seen.executed)
            self._buffer.executed(action)  # a hold stays where the hand is, not where it was asked to go
        return Step(
            episode=episode.episode,
            goal_seq=episode.goal_seq,
            k=self._k,
            steps=episode.steps,
            mode=episode.mode,
            state=seen.state,
            part_valid=seen.part_valid,
            part_age_ms=seen.part_age_ms,
            prev_action=action,
            goal=seen.goal,
            chunk_seq=executed.chunk_seq,
            chunk_offset=executed.chunk_offset,
            fallback=executed.fallback,
            first=self._k == 0,
            last=last,
            waiting=waiting,
            dropped=seen.dropped,
        )

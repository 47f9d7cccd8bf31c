"""What the curriculum does next: pure functions from what has been done to the next episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import Frozen
from common.messages import WARMUP_MODES, Mode
from deploy.curriculum_config import FIRST_EVALUATION_SEED, CurriculumProcess

_STREAMS = {Mode.RANDOM: 0, Mode.GLOVE: 0, Mode.PLAN: 1}


class Assignment(Frozen):
    """An episode to run; `index` counts within its kind: warm-up, training goal or held-out goal."""

    episode: int
    mode: Mode
    index: int
    seed: int


class Pending(Frozen, extra="ignore"):  # older files also say in which of the plant's lives it ran
    """A finished episode whose acknowledgement is still to come.

    A restarted plant runs its episode again, and the learner keeps the first whole try: either settles it.
    """

    episode: int
    mode: Mode
    steps: int


class Progress(Frozen):
    """All that has been done and decided; a run goes on from it after any crash."""

    assigned: Assignment | None = None
    next_id: int = 0  # ids are given out once, also when a run is taken up again
    warmups: int = 0  # warm-up episodes begun
    warmup_steps: int = 0  # of finished warm-up episodes that are not lost
    trained: int = 0  # finished training episodes
    evaluated_at: int = -1  # training episodes before the newest complete evaluation
    goals_done: int = 0  # of the evaluation that is under way
    pending: tuple[Pending, ...] = ()
    newest_stored_goal: int = -1  # newest training episode that the learner has acknowledged
    updated_after: int = -1  # newest episode that an update has seen
    lost: int = 0  # episodes that were never acknowledged


@dataclass(frozen=True)
class Waiting:
    """Nothing may start yet; `reason` is for people."""

    reason: str


@dataclass(frozen=True)
class Done:
    """Everything asked for has been done."""


def decide(progress: Progress, config: CurriculumProcess) -> Assignment | Waiting | Done:
    """Return the next episode, or why none may start; called only while no episode is assigned."""
    pending = progress.pending
    if pending and pending[0].episode + 2 <= progress.next_id:
        # The plant's history of steps is bounded: a learner that is far behind would miss some.
        return _waiting_for_ack(pending[0])
    if progress.warmup_steps < config.warmup_steps:
        kind = Mode.GLOVE if config.curriculum.warmup == "glove" else Mode.RANDOM
        return _assignment(progress, config, kind, progress.warmups)
    if pending and pending[0].mode in WARMUP_MODES:
        return _waiting_for_ack(pending[0])
    if config.warmup_steps and progress.updated_after < 0:
        return Waiting("waiting for the first update")
    return _decide_goal(progress, config)


def _decide_goal(progress: Progress, config: CurriculumProcess) -> Assignment | Waiting | Done:
    finished = progress.trained >= config.curriculum.episodes
    if config.curriculum.wait_for_update or finished:
        if progress.pending:
            return _waiting_for_ack(progress.pending[0])
        if progress.updated_after < progress.newest_stored_goal:
            return Waiting(f"waiting for the update after episode {progress.newest_stored_goal}")
    if evaluation_due(progress, config):
        return _assignment(progress, config, Mode.EVALUATE, progress.goals_done)
    return Done() if finished else _assignment(progress, config, Mode.PLAN, progress.trained)


def evaluation_due(progress: Progress, config: CurriculumProcess) -> bool:
    """Whether the present model is to be evaluated: before the first goal, every so often, at the end."""
    plan = config.curriculum
    regular = progress.trained % plan.evaluate_every == 0 or progress.trained >= plan.episodes
    return plan.evaluate_goals > 0 and progress.evaluated_at < progress.trained and regular


def _waiting_for_ack(pending: Pending) -> Waiting:
    return Waiting(f"waiting for ack of episode {pending.episode}")


def _assignment(progress: Progress, config: CurriculumProcess, mode: Mode, index: int) -> Assignment:
    return Assignment(episode=progress.next_id, mode=mode, index=index, seed=_seed(config, mode, index))


def _seed(config: CurriculumProcess, mode: Mode, index: int) -> int:
    """Seed of an episode: below 10⁶ in training and the same for every method, from 10⁶ up in evaluations."""
    if mode is Mode.EVALUATE:
        return config.curriculum.evaluation_seed + index
    sequence = np.random.SeedSequence((config.seed, _STREAMS[mode], index))
    return int(sequence.generate_state(1)[0]) % FIRST_EVALUATION_SEED


def assign(progress: Progress, assignment: Assignment) -> Progress:
    """Give out the next id."""
    warmups = progress.warmups + (assignment.mode in WARMUP_MODES)
    update = {"assigned": assignment, "next_id": assignment.episode + 1, "warmups": warmups}
    return progress.model_copy(update=update)


def idle(progress: Progress) -> Assignment:
    """Return the assignment that tells everybody that the run has ended."""
    return Assignment(episode=progress.next_id, mode=Mode.IDLE, index=0, seed=0)


def finish(progress: Progress, steps: int, config: CurriculumProcess) -> Progress:
    """Account for the assigned episode, run to its end with `steps` steps."""
    done = progress.assigned
    if done is None:
        raise ValueError("no episode is assigned")
    if done.mode is Mode.EVALUATE:
        return progress.model_copy(update={"assigned": None} | _evaluated(progress, config))
    waiting = Pending(episode=done.episode, mode=done.mode, steps=steps)
    update: dict[str, object] = {"assigned": None, "pending": (*progress.pending, waiting)}
    if done.mode in WARMUP_MODES:
        update["warmup_steps"] = progress.warmup_steps + steps
    else:
        update["trained"] = progress.trained + 1
    return progress.model_copy(update=update)


def _evaluated(progress: Progress, config: CurriculumProcess) -> dict[str, int]:
    goals = progress.goals_done + 1
    if goals < config.curriculum.evaluate_goals:
        return {"goals_done": goals}
    return {"goals_done": 0, "evaluated_at": progress.trained}


def acknowledge(progress: Progress, pending: Pending) -> Progress:
    """Note that the learner has stored an episode."""
    update: dict[str, object] = {"pending": _without(progress, pending)}
    if pending.mode is Mode.PLAN:
        update["newest_stored_goal"] = max(progress.newest_stored_goal, pending.episode)
    return progress.model_copy(update=update)


def lose(progress: Progress, pending: Pending) -> Progress:
    """Give an episode up; a warm-up episode is made up for by another one."""
    warmup_steps = progress.warmup_steps - (pending.steps if pending.mode in WARMUP_MODES else 0)
    update = {"pending": _without(progress, pending), "lost": progress.lost + 1, "warmup_steps": warmup_steps}
    return progress.model_copy(update=update)


def stored_by(progress: Progress, episode: int) -> int:
    """How many episodes up to and with `episode` the learner must have if it has missed none."""
    running = progress.assigned
    begun = progress.warmups + progress.trained + (running is not None and running.mode is Mode.PLAN)
    unfinished = running is not None and running.mode in _STREAMS and running.episode > episode
    newer = sum(item.episode > episode for item in progress.pending)
    return begun - progress.lost - unfinished - newer


def _without(progress: Progress, pending: Pending) -> tuple[Pending, ...]:
    return tuple(item for item in progress.pending if item.episode != pending.episode)


def planned_left(progress: Progress, config: CurriculumProcess) -> int:
    """How many training and evaluation episodes are still to be run."""
    plan = config.curriculum
    after = range(max(progress.trained, progress.evaluated_at + 1), plan.episodes + 1)
    due = sum(n % plan.evaluate_every == 0 or n == plan.episodes for n in after)
    return max(0, plan.episodes - progress.trained) + due * plan.evaluate_goals - progress.goals_done


def episodes_total(progress: Progress, config: CurriculumProcess) -> int:
    """How many episodes the whole run has, as far as is known now: lost ones add to the warm-up."""
    left_steps = max(0, config.warmup_steps - progress.warmup_steps)
    warmups_left = -(-left_steps // config.curriculum.episode_steps)
    ended = progress.next_id - (progress.assigned is not None)
    return ended + warmups_left + planned_left(progress, config)

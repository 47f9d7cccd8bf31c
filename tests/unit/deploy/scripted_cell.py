"""A plant and a learner that do what a test says, for running the curriculum without physics or networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from common.built import codec_for
from common.bus import Inbox, Input, LocalBus
from common.clock import VirtualClock
from common.config import parse
from common.lockstep import Lockstep
from common.messages import Ack, Episode, Fallback, Metrics, Mode, Step
from common.runner import Dispatcher
from common.service import Job, Output, Publish, Report
from common.task import Task, get_task
from common.topics import ACK, EPISODE, METRICS, STEP
from deploy.curriculum import CurriculumService, build
from deploy.curriculum_config import CurriculumProcess

TASK = get_task("reach")
SECOND_NS = 10**9


def config(run_dir: Path, **curriculum) -> CurriculumProcess:
    plan = {"episodes": 3, "episode_steps": 5, "evaluate_every": 2, "evaluate_goals": 2, **curriculum}
    return parse(
        CurriculumProcess,
        {"run_dir": str(run_dir), "warmup_steps": 20, "seed": 7, "curriculum": plan},
        "test",
    )


def step_message(episode: Episode, k: int, task: Task = TASK, **changes) -> Step:
    values = {
        "episode": episode.episode,
        "goal_seq": episode.goal_seq,
        "k": k,
        "steps": episode.steps,
        "mode": episode.mode,
        "state": np.full(task.state_dim, 0.01 * k, np.float32),
        "part_valid": np.ones(len(task.groups), np.uint8),
        "part_age_ms": np.zeros(len(task.groups), np.float32),
        "prev_action": np.zeros(task.action_dim, np.float32),
        "goal": np.zeros(task.goal_dim, np.float32),
        "chunk_seq": -1,
        "chunk_offset": -1,
        "fallback": Fallback.NONE,
        "first": k == 0,
        "last": k == episode.steps,
        "waiting": False,
        "dropped": False,
    }
    return Step(**(values | changes))


class ScriptedPlant:
    """Runs every new episode at once, except that it dies half-way in those of `dies_in`."""

    name = "sim"
    inputs = (Input(EPISODE, newest=True, wake=True),)
    period_ns = None

    def __init__(self, boot_id: int = 1, dies_in: tuple[int, ...] = (), task: Task = TASK) -> None:
        self.boot_id = boot_id
        self.task = task
        self.dies_in = dies_in
        self.seen: list[Episode] = []
        self.times_ns: dict[int, int] = {}

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        out: list[Output] = []
        for sample in inbox.take(EPISODE):
            episode: Episode = sample.message
            if self.seen and self.seen[-1].episode == episode.episode:
                continue
            self.seen.append(episode)
            self.times_ns[episode.episode] = now_ns
            if episode.mode is not Mode.IDLE:
                out += self._run(episode)
        return out

    def _run(self, episode: Episode) -> list[Output]:
        waiting = [] if episode.mode is Mode.RANDOM else [step_message(episode, 0, self.task, waiting=True)]
        steps = [step_message(episode, k, self.task) for k in range(episode.steps + 1)]
        if episode.episode in self.dies_in:
            steps = steps[: len(steps) // 2]
        return [Publish(STEP, message) for message in waiting + steps]

    def stop(self, now_ns: int) -> list[Output]:
        return []

    def report(self) -> Report:
        return Report("")


class ScriptedLearner:
    """Acknowledges after `ack_ns` all but `loses`, and updates for `update_ns` after each goal."""

    name = "learner"
    inputs = (Input(STEP, wake=True),)
    period_ns = SECOND_NS // 10
    boot_id = 3

    def __init__(self, warmup_steps: int, ack_ns=0, update_ns=SECOND_NS, loses: tuple[int, ...] = ()) -> None:
        self.warmup_steps = warmup_steps
        self.ack_ns, self.update_ns, self.loses = ack_ns, update_ns, loses
        self.silent: tuple[int, ...] = ()  # stored, but the ack gets lost
        self.stored_as: dict[int, int] = {}  # episodes that are on disk from another life of the plant
        self.steps = 0
        self.episodes = 0
        self.newest = -1
        self.trained = False
        self.due: list[tuple[int, int]] = []  # (ns, episode) of the updates under way
        self.acked_ns: dict[int, int] = {}
        self.updated_ns: dict[int, int] = {}

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        out: list[Output] = []
        for sample in inbox.take(STEP):
            step: Step = sample.message
            stored = step.last and step.mode is not Mode.EVALUATE and step.episode not in self.loses
            if stored:
                key = (sample.header.boot_id, step)
                out.append(Job("store", lambda key=key: key, latency_ns=self.ack_ns))
        for result in inbox.results:
            out += self._stored(result.value, now_ns)
        for due_ns, episode in list(self.due):
            if now_ns >= due_ns:
                self.due.remove((due_ns, episode))
                out.append(self.update(episode, now_ns))
        return out

    def update(self, episode: int, now_ns: int) -> Output:
        self.updated_ns[episode] = now_ns
        return Publish(METRICS, _metrics(episode))

    def _stored(self, value: object, now_ns: int) -> list[Output]:
        boot_id, step = value
        if step.episode in self.stored_as:
            self.steps += step.k
            return [Publish(ACK, Ack(self.stored_as[step.episode], step.episode, self.episodes, self.steps))]
        self.acked_ns[step.episode] = now_ns
        self.steps += step.k
        self.episodes += 1
        self.newest = step.episode
        if step.mode is Mode.PLAN if self.trained else self.steps >= self.warmup_steps:
            self.trained = True
            self.due.append((now_ns + self.update_ns, self.newest))
        if step.episode in self.silent:
            return []
        return [Publish(ACK, Ack(boot_id, step.episode, self.episodes, self.steps))]

    def stop(self, now_ns: int) -> list[Output]:
        return []

    def report(self) -> Report:
        return Report("")


def _metrics(after: int) -> Metrics:
    return Metrics(after, 1, 1, 1, "id", 1.0, {}, {}, {})


class ScriptedCell:
    """A curriculum with its scripted partners; `run` goes on until it finishes or the limit passes."""

    def __init__(
        self,
        settings: CurriculumProcess,
        plant: ScriptedPlant | None = None,
        learner: ScriptedLearner | None = None,
    ) -> None:
        self.plant = plant or ScriptedPlant(task=get_task(settings.task))
        self.codec = codec_for(settings.task)
        self.learner = learner or ScriptedLearner(settings.warmup_steps)
        self.bus = LocalBus()
        service = build(settings, boot_id=2).service
        assert isinstance(service, CurriculumService)
        self.curriculum = service
        self.dispatchers = [
            Dispatcher(each, self.codec, self.bus, {}) for each in (self.plant, self.curriculum, self.learner)
        ]
        self.lockstep = Lockstep(self.dispatchers, VirtualClock())
        self.instants = 0
        self.published: list[Episode] = []
        self.bus.subscribe(EPISODE, self._note)

    def _note(self, key: str, payload: bytes) -> None:
        self.published.append(self.codec.decode(key, payload).message)

    def run(self, seconds: float = 10_000, instants: int = 10**9) -> bool:
        """True: finished."""

        def stop() -> bool:
            self.instants += 1
            return self.instants > instants

        self.lockstep.run(stop, round(seconds * SECOND_NS))
        return self.dispatchers[1].finish is not None

    @property
    def modes(self) -> list[str]:
        return [episode.mode.value for episode in self.published]

"""One compared method as a service, in place of planner and learner: it acts at every step, and learns.

For lock-step alone: the plant stands still while it decides, so x = 1. An advantage over the asynchronous
planner, which sees a state that is x steps old.
"""

from __future__ import annotations

import numpy as np

from bench.agent_worker import AgentWorker, Learned, Stored
from bench.baselines.controller import Controller, Float32, derived_seed
from common.bus import Inbox, Input, JobResult
from common.messages import Ack, Chunk, Header, Metrics, Mode, Step
from common.service import Job, Output, Publish, Report
from common.topics import ACK, CHUNK, METRICS, STEP
from services.learner.recorder import Recorder


class AgentService:
    """State machine; without a worker it acts with what it has learned, and no more."""

    name = "agent"
    inputs = (Input(STEP, wake=True),)
    period_ns: int | None = None

    def __init__(
        self,
        controller: Controller,
        worker: AgentWorker | None,
        boot_id: int,
        *,
        method: str,
        seed: int,
        decide_ns: int,
        updates: int = 0,
    ) -> None:
        """`decide_ns` is how long a decision takes in virtual time; `updates` what made a finished agent."""
        self.boot_id = boot_id
        self._controller = controller
        self._worker = worker
        self._method = method
        self._seed = seed
        self._decide_ns = decide_ns
        self._finished = Learned({}, updates, 0, -1)
        self._recorder = Recorder()
        self._acting = (0, -1)  # plant boot and episode that the controller is acting in
        self._asked: tuple[Header, Step] | None = None  # for an action, and not answered yet
        self._deciding: tuple[Header, Step] | None = None
        self._learning = False
        self._begun = False
        self._error = ""

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Answer a plant that waits, store what is finished, and go on learning."""
        out: list[Output] = [] if self._begun else self._resumed()
        for result in inbox.results:
            self._take_result(result, out)
        # After a failure nothing more is done: virtual time passes until the run is given up.
        if self._error:
            return out
        for sample in inbox.take(STEP):
            self._take_step(sample.header, sample.message, out)
        if self._worker is not None and self._worker.has_work:
            self._learn(self._worker, out)
        else:
            self._decide(out)
        return out

    def stop(self, now_ns: int) -> list[Output]:
        """Save what was learned since the last checkpoint."""
        if self._worker is not None:
            self._worker.save()
        return []

    def report(self) -> Report:
        """What it is doing, and how much it has stored and learned."""
        episodes, steps = self._worker.stored if self._worker else (0, 0)
        fields = {"stored_episodes": episodes, "stored_steps": steps, "updates": self._newest.updates}
        state = self._error or ("learning" if self._learning else "ready")
        return Report(state, {name: float(value) for name, value in fields.items()})

    @property
    def _newest(self) -> Learned:
        return self._worker.newest if self._worker else self._finished

    def _resumed(self) -> list[Output]:
        """Say again what may have got lost with the process that was here before."""
        self._begun = True
        if self._worker is None:
            return []
        keys = self._worker.newest_keys(ACK.latched)
        out: list[Output] = [Publish(ACK, Ack(*key, *self._worker.stored)) for key in keys]
        if self._newest.episodes and not self._worker.has_work:
            out.append(self._metrics())
        return out

    # --- acting -----------------------------------------------------------------------------------------

    def _take_step(self, header: Header, step: Step, out: list[Output]) -> None:
        if self._worker is not None:
            episode = self._recorder.add(header, step)
            if episode is not None:
                out.append(Job("store", self._worker.store, (episode,), lane="learn"))
        if step.waiting and not step.last and step.mode in (Mode.PLAN, Mode.EVALUATE):
            self._asked = (header, step)

    def _decide(self, out: list[Output]) -> None:
        """Answer the plant; never before all is learned, which a run that is taken up again does first."""
        if self._asked is not None and self._deciding is None:
            self._deciding, self._asked = self._asked, None
            header, step = self._deciding
            out.append(Job("act", self._act, (header.boot_id, step), self._decide_ns))

    def _act(self, plant_boot_id: int, step: Step) -> Float32:
        if self._acting != (plant_boot_id, step.episode):
            self._acting = (plant_boot_id, step.episode)
            seed = derived_seed(self._seed, "act", step.episode)
            self._controller.begin(seed, explore=step.mode is Mode.PLAN)
        return self._controller.act(step.state, step.goal)

    def _chunk(self, action: Float32) -> Publish:
        assert self._deciding is not None
        header, step = self._deciding
        self._deciding = None
        chunk = Chunk(
            plant_boot_id=header.boot_id,
            episode=step.episode,
            goal_seq=step.goal_seq,
            first_k=step.k,
            commit=1,
            actions=action[None],
            source_k=step.k,
            source_t_ns=header.t_ns,
            predicted_k=step.k,
            predicted_state=step.state,
            predicted_std=np.zeros_like(step.state),
            score=0.0,
            snapshot_id=self._snapshot_id(),
            solve_ms=self._decide_ns / 1e6,
        )
        return Publish(CHUNK, chunk)

    # --- learning ---------------------------------------------------------------------------------------

    def _learn(self, worker: AgentWorker, out: list[Output]) -> None:
        if not self._learning:
            self._learning = True
            out.append(Job("learn", worker.learn, lane="learn"))

    def _take_result(self, result: JobResult, out: list[Output]) -> None:
        """Pass on what a job came to."""
        value = result.value
        if result.error:
            self._error = f"{result.name} failed: {result.error}"
        elif isinstance(value, Stored):
            out.append(Publish(ACK, Ack(value.boot_id, value.episode, value.episodes, value.steps)))
        elif isinstance(value, Learned):
            self._learning = False
            if self._worker is not None and not self._worker.has_work:
                out.append(self._metrics())
        elif isinstance(value, np.ndarray):
            out.append(self._chunk(value))

    def _metrics(self) -> Publish:
        newest = self._newest
        steps = self._worker.stored[1] if self._worker else 0
        message = Metrics(
            after_episode=newest.after_episode,
            episodes=newest.episodes,
            steps=steps,
            updates=newest.updates,
            snapshot_id=self._snapshot_id(),
            update_ms=0.0,
            loss=newest.losses,
            holdout={},
            calibration={},
        )
        return Publish(METRICS, message)

    def _snapshot_id(self) -> str:
        return f"{self._method}-{self._newest.updates}"

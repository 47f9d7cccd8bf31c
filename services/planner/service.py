"""Asynchronous MPC (Sec. III-B): while the plant executes x actions, the next chunk is planned."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from common.bus import Inbox, Input, JobResult
from common.cell import SharedConfig
from common.executor import ActionBuffer
from common.messages import Chunk, Fallback, Float32, Header, Mode, Sample, SnapshotMessage, Step
from common.service import Job, Output, Publish, Report
from common.task import Task
from common.topics import CHUNK, METRICS, SNAPSHOT, STEP
from services.planner.config import PlannerConfig
from services.planner.executed import Executed
from services.planner.mpc import steps_per_plan
from services.planner.solver import Prepared, Request, Solution, Solver, held_noise

SOLVE_WINDOW = 200
RETRY_NS = 500_000_000  # after a plan that failed
DIVERGED_SCORE = -1e30  # stands for the -inf of a plan of which every candidate diverged
SNAPSHOT_NS = 2_000_000_000  # how long a snapshot may be on its way
AUTO_PLANS = 20  # measured before x = auto goes by them: the first ones are slow
AUTO_MARGIN_MS = 3.0  # for the way to the plant and back
AUTO_QUANTILE = 0.95  # x = auto is set by the solve time that 95 % of the plans stay below


@dataclass
class _Progress:
    """Where planning stands within one episode and goal."""

    identity: tuple[int, int, int]  # plant boot, episode, goal
    planned_from: int = -1  # first step of the newest chunk that was requested
    answered_seq: int = -1  # of the newest step when the newest chunk was sent
    x: int = 1
    noise: Float32 | None = None
    executed: Executed = field(default_factory=Executed)


class PlannerService:
    """State machine of the planner: the newest state in, a chunk out, one plan at a time."""

    name = "planner"
    inputs = (
        Input(STEP, newest=True, wake=True),
        Input(SNAPSHOT, newest=True, wake=True),
        Input(METRICS, newest=True),
    )
    period_ns: int | None = RETRY_NS

    def __init__(
        self, config: SharedConfig, planner: PlannerConfig, task: Task, solver: Solver, boot_id: int
    ) -> None:
        self._control = config.control
        self._config = planner
        self._seed = config.seed
        self._task = task
        self._solver = solver
        self.boot_id = boot_id
        self._mirror = ActionBuffer(task.action_dim, 0, config.control.hold_steps)
        self._progress = _Progress((0, 0, 0))
        self._solving: Request | None = None
        self._model: Prepared | None = None
        self._unloaded: SnapshotMessage | None = None  # the newest; waits while an older one is prepared
        self._loading = False
        self._sent = 0
        self._not_before_ns = 0
        self._awaited = ""
        self._latency_ns = round(planner.declared_solve_ms * 1e6)
        self._solve_ms: deque[float] = deque(maxlen=SOLVE_WINDOW)
        self._wait_ms: deque[float] = deque(maxlen=SOLVE_WINDOW)
        self._counts: Counter[str] = Counter()
        self._last_error = ""

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Publish what is solved, load what has arrived, and plan from the newest state if it is time to."""
        out: list[Output] = []
        newest = inbox.newest(STEP)
        for result in inbox.results:
            self._take_result(result, now_ns, newest, out)
        self._awaited = self._awaited_snapshot(inbox, now_ns)
        if newest is not None and now_ns >= self._not_before_ns:
            begun = self._consider(newest.header, newest.message, out)
            if begun and not newest.message.waiting:
                self._wait_ms.append(inbox.status(STEP, now_ns).age_ns / 1e6)
        for sample in inbox.take(SNAPSHOT):
            self._unloaded = sample.message
        self._load(out)  # last: a plant that stands still must get a plan between two loads
        return out

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving."""
        return []

    def report(self) -> Report:
        """Plan times over the last plans, counts since the start of the process."""
        p50, p99 = np.percentile(self._solve_ms, (50, 99)) if self._solve_ms else (0.0, 0.0)
        fields = {"plan_ms_p50": float(p50), "plan_ms_p99": float(p99), "x": float(self._progress.x)}
        fields["plan_wait_ms_max"] = max(self._wait_ms, default=0.0)  # from a step's arrival on
        fields |= {
            key: float(self._counts[key])
            for key in ("plans", "snapshots", "refused_snapshots", "invalid_states")
        }
        fields |= {key: float(self._counts[key]) for key in ("diverged_plans", "failed_plans", "stale_plans")}
        return Report(self._state(), fields)

    def _state(self) -> str:
        if self._last_error:
            return self._last_error
        if self._model is None:
            return "waiting for a model"
        return "planning" if self._solving else "ready"

    def _x(self) -> int:
        """x as configured, or for `auto` from the solve times so far; always less than the horizon."""
        if isinstance(self._control.steps_per_plan, int):
            return self._control.steps_per_plan
        enough = len(self._solve_ms) >= AUTO_PLANS
        solve_ms = np.quantile(self._solve_ms, AUTO_QUANTILE) if enough else self._config.declared_solve_ms
        x = steps_per_plan(self._control.rate_hz, float(solve_ms + AUTO_MARGIN_MS) / 1e3)
        return min(x, max(1, self._config.horizon - 1))

    def _awaited_snapshot(self, inbox: Inbox, now_ns: int) -> str:
        """The id of a snapshot that the learner has told of and that is still on its way here, if any.

        It is large and travels behind everything else; after SNAPSHOT_NS it counts as lost.
        """
        told = inbox.newest(METRICS)
        if told is None or inbox.status(METRICS, now_ns).age_ns > SNAPSHOT_NS:
            return ""
        have = self._model.snapshot_id if self._model else ""
        return "" if told.message.snapshot_id == have else told.message.snapshot_id

    # --- results ---------------------------------------------------------------------------------

    def _take_result(self, result: JobResult, now_ns: int, newest: Sample | None, out: list[Output]) -> None:
        if result.name == "load":
            self._loading = False
            self._take_model(result)
            return
        request, self._solving = self._solving, None
        if result.error:
            self._counts["failed_plans"] += 1
            self._last_error = f"plan failed: {result.error}"
            self._progress.planned_from = -1  # a plant that stands waiting sends nothing that would ask again
            self._not_before_ns = now_ns + RETRY_NS
        elif isinstance(result.value, Solution) and request is not None:
            self._last_error = ""
            self._publish(result.value, result.duration_ns / 1e6, newest, out)

    def _take_model(self, result: JobResult) -> None:
        if not isinstance(result.value, Prepared):
            self._counts["refused_snapshots"] += 1
            self._last_error = f"snapshot refused: {result.error}"
            return
        self._counts["snapshots"] += 1
        self._model = result.value
        self._last_error = ""

    def _load(self, out: list[Output]) -> None:
        """Prepare the newest snapshot beside planning; the plans after that are made with it."""
        if self._unloaded is None or self._loading:
            return
        self._loading = True
        out.append(Job("load", self._solver.prepare, (self._unloaded.payload,), lane="load"))
        self._unloaded = None

    def _publish(self, solution: Solution, solve_ms: float, newest: Sample | None, out: list[Output]) -> None:
        """Send the chunk unless the goal it was made for is gone."""
        self._solve_ms.append(solve_ms)
        self._counts["plans"] += 1
        self._counts["diverged_plans"] += not solution.valid
        request = solution.request
        if (request.plant_boot_id, request.episode, request.goal_seq) != self._progress.identity:
            self._counts["stale_plans"] += 1
            return
        chunk = self._chunk(solution, solve_ms)
        if newest is not None:
            # The first step whose action the plant has not chosen yet.
            self._mirror.offer(chunk, self._sent, newest.message.k + (not newest.message.waiting))
            self._progress.answered_seq = newest.header.seq
        self._sent += 1
        out.append(Publish(CHUNK, chunk, valid=solution.valid))

    def _chunk(self, solution: Solution, solve_ms: float) -> Chunk:
        request = solution.request
        length = len(solution.actions) if self._control.chunk == "horizon" else request.commit
        return Chunk(
            plant_boot_id=request.plant_boot_id,
            episode=request.episode,
            goal_seq=request.goal_seq,
            first_k=request.first_k,
            commit=request.commit,
            actions=solution.actions[:length],
            source_k=request.source_k,
            source_t_ns=request.source_t_ns,
            predicted_k=solution.predicted_k,
            predicted_state=solution.predicted_state,
            predicted_std=solution.predicted_std,
            score=max(solution.score, DIVERGED_SCORE),
            snapshot_id=solution.snapshot_id,
            solve_ms=solve_ms,
        )

    # --- requests --------------------------------------------------------------------------------

    def _consider(self, header: Header, step: Step, out: list[Output]) -> bool:
        """Begin a plan from this step if it is time to; tell whether one was begun."""
        if step.mode not in (Mode.PLAN, Mode.EVALUATE) or step.last:
            return False
        self._follow(header, step)
        measured = bool(header.valid and step.part_valid.all())
        self._progress.executed.add(step.k, step.prev_action, step.state if measured else None)
        if not measured:
            self._counts["invalid_states"] += 1
            return False
        # A plant that stands still can wait for the newest model.
        outdated = step.waiting and (self._loading or bool(self._awaited))
        if self._solving or self._model is None or outdated:
            return False
        request = self._request(header, step)
        if request is None:
            return False
        self._solving = request
        self._progress.planned_from = request.first_k
        out.append(Job("plan", self._solver.solve, (request, self._model), self._latency_ns))
        return True

    def _follow(self, header: Header, step: Step) -> None:
        """Keep the mirror of the plant's buffer in step with what the plant says that it executed."""
        identity = (header.boot_id, step.episode, step.goal_seq)
        if identity[:2] != self._progress.identity[:2]:
            self._mirror.reset(*identity)
            self._progress = _Progress(identity, x=self._x())  # one x for a whole episode
        elif identity != self._progress.identity:
            self._mirror.change_goal(*identity)
            self._progress.identity = identity
            self._progress.planned_from = -1
        held = step.fallback in (Fallback.HOLD, Fallback.RELAX)
        self._mirror.follow(step.k, step.prev_action, held)

    def _request(self, header: Header, step: Step) -> Request | None:
        """Decide what to plan from this step, if anything: every x steps, or once the planner is free."""
        x = self._progress.x
        ahead = 0 if step.waiting or self._control.synchronous else x
        first_k = step.k + ahead
        asked_again = step.waiting and header.seq > self._progress.answered_seq
        due = asked_again or self._progress.planned_from < 0 or first_k >= self._progress.planned_from + x
        already = self._control.synchronous and not step.waiting
        if not due or already or first_k >= step.steps:
            return None
        seen_states, seen_actions = self._progress.executed.take()
        return Request(
            plant_boot_id=header.boot_id,
            episode=step.episode,
            goal_seq=step.goal_seq,
            source_k=step.k,
            source_t_ns=header.t_ns,
            first_k=first_k,
            commit=x,
            steps=step.steps,
            state=step.state,
            goal=step.goal,
            committed=self._mirror.peek(step.k, ahead),
            noise=self._noise(step),
            seen_states=seen_states,
            seen_actions=seen_actions,
        )

    def _noise(self, step: Step) -> Float32:
        """Exploration noise of this episode (steps, A): zero in evaluations and where none is wanted."""
        if self._progress.noise is None:
            config = self._config
            explores = step.mode is Mode.PLAN and config.explore_std > 0
            std = config.explore_std if explores and step.episode % config.explore_every == 0 else 0.0
            self._progress.noise = held_noise(
                self._seed,
                step.episode,
                step.steps,
                self._task.action_dim,
                std=std,
                redraw=config.explore_redraw,
            )
        return self._progress.noise

"""The planner's long work: preparing snapshots, and solving plans beside it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import torch

from common.messages import Float32
from common.model.dynamics import Dynamics
from common.model.snapshot import Snapshot
from common.task import Task
from services.planner.config import PlannerConfig
from services.planner.correction import Correction
from services.planner.mpc import Mpc
from services.planner.particles import Particles, particles

PREDICTION_LIMIT = 1e6  # what the codec lets pass


@dataclass(frozen=True)
class Request:
    """What to plan: from the state (S,) of step k through `committed` (x, A) towards the goal (G,)."""

    plant_boot_id: int
    episode: int
    goal_seq: int
    source_k: int
    source_t_ns: int
    first_k: int
    commit: int
    steps: int  # of the episode
    state: Float32
    goal: Float32
    committed: Float32
    noise: Float32  # (steps, A), added to the plan's actions; zero unless the episode explores
    seen_states: Float32  # (T + 1, S), of the executed steps since the last request, the newest last
    seen_actions: Float32  # (T, A)


@dataclass(frozen=True)
class Solution:
    """Actions (T, A) for steps first_k, first_k + 1, ..., and the state expected at `predicted_k`."""

    request: Request
    actions: Float32
    predicted_k: int
    predicted_state: Float32
    predicted_std: Float32
    score: float
    valid: bool  # False: every candidate diverged
    snapshot_id: str


@dataclass(frozen=True, eq=False)
class Prepared:
    """A snapshot's networks, laid out for planning; nothing changes it any more.

    `corrected` (D,): the error that a step counts for at most in the correction of what they predict.
    """

    snapshot_id: str
    particles: Particles
    corrected: torch.Tensor


class Solver:
    """Owns the Mpc. `prepare` changes nothing, so that it may run beside `solve`, on another worker."""

    def __init__(self, config: PlannerConfig, task: Task, seed: int) -> None:
        torch.set_num_threads(config.threads)
        self._config = config
        self._task = task
        self._seed = seed
        self._mpc = Mpc(config, task)
        self._prepared: Prepared | None = None  # what the Mpc plans with
        self._episode = (0, 0)
        self._correction: Correction | None = None

    def prepare(self, payload: bytes) -> Prepared:
        """Check a snapshot and fold it for planning. Raises SnapshotRefused or ValueError."""
        snapshot = Snapshot.from_bytes(payload)
        dynamics = snapshot.dynamics(self._task)
        pool = snapshot.masks if snapshot.meta.model.dropout > 0 else None
        config = self._config
        sampled = config.propagation == "sampled"
        model = particles(dynamics, pool, config.members, config.masks, sampled=sampled, device=config.device)
        if config.refines and config.refine == "adam":
            for layer in model.network.layers:
                _ = layer.transposed  # made here, or the first plan would take longer
        return Prepared(snapshot.id, model, self._corrected(dynamics))

    def _corrected(self, dynamics: Dynamics) -> torch.Tensor:
        most = torch.zeros_like(dynamics.normaliser.delta_std)
        for group in self._task.groups:
            if group.name in self._config.correction_groups:
                part = dynamics.coordinates.part(group)
                most[part] = self._config.correction_bound * dynamics.normaliser.delta_std[part]
        return most.to(self._config.device)

    def solve(self, request: Request, prepared: Prepared) -> Solution:
        """Make one plan; the same request, model and history give the same plan on every machine."""
        if prepared is not self._prepared:
            self._begin_model(prepared)
        if (request.plant_boot_id, request.episode) != self._episode:
            self._episode = (request.plant_boot_id, request.episode)
            self._mpc.reset()
            if self._correction is not None:
                self._correction.reset()
        self._correct(request, prepared)
        device = self._config.device
        state = torch.from_numpy(request.state.copy()).to(device)
        plan = self._mpc.plan(
            state,
            torch.from_numpy(request.goal.copy()).to(device),
            torch.from_numpy(request.committed.copy()).to(device),
            request.steps - request.source_k,
            self._generator(request),
        )
        actions = self._explored(plan.actions.cpu().numpy(), request)
        mean, std = plan.predicted_mean, plan.predicted_std
        if request.noise.any():  # what will be executed is not what was planned
            executed = np.concatenate([request.committed, actions])
            mean, std = self._mpc.predict(state, torch.from_numpy(executed).to(device))
        expected = min(len(request.committed) + request.commit, len(mean)) - 1
        return Solution(
            request=request,
            actions=actions,
            predicted_k=request.source_k + expected + 1,
            predicted_state=_sendable(mean[expected]),
            predicted_std=_sendable(std[expected]),
            score=plan.score,
            valid=plan.valid,
            snapshot_id=prepared.snapshot_id,
        )

    def _begin_model(self, prepared: Prepared) -> None:
        self._prepared = prepared
        self._mpc.set_model(prepared.particles)
        if self._config.correction > 0.0:
            config = self._config
            self._correction = Correction(config.correction, prepared.corrected, config.correction_pace)

    def _correct(self, request: Request, prepared: Prepared) -> None:
        """Hold the model's predictions against what has been executed since the last plan."""
        if self._correction is None:
            return
        device = self._config.device
        states, actions = (
            torch.from_numpy(x).to(device) for x in (request.seen_states, request.seen_actions)
        )
        with torch.no_grad():
            self._correction.observe(prepared.particles, states, actions)
        self._mpc.set_model(self._correction.of(prepared.particles))

    def _generator(self, request: Request) -> torch.Generator:
        """Seeded by what is planned, not by what was planned before: late plans change no later one."""
        text = f"{self._seed}/{request.episode}/{request.goal_seq}/{request.first_k}"
        digest = hashlib.sha256(text.encode()).digest()
        seed = int.from_bytes(digest[:8], "little") >> 1
        return torch.Generator(self._config.device).manual_seed(seed)

    def _explored(self, actions: Float32, request: Request) -> Float32:
        noise = request.noise[request.first_k : request.first_k + len(actions)]
        actions = actions.copy()
        actions[: len(noise)] += noise
        return np.clip(actions, -1.0, 1.0)


def _sendable(prediction: torch.Tensor) -> Float32:
    """A prediction (S,) that a message may carry, however far the model has diverged."""
    return np.nan_to_num(prediction.cpu().numpy(), nan=0.0).clip(-PREDICTION_LIMIT, PREDICTION_LIMIT)


def held_noise(seed: int, episode: int, steps: int, action_dim: int, *, std: float, redraw: float) -> Float32:
    """Exploration noise (steps, A): a joint keeps its offset until redrawn, with chance `redraw` a step."""
    generator = np.random.default_rng((seed, episode, 7))
    noise = np.zeros((steps, action_dim), np.float32)
    current = generator.normal(0.0, std, action_dim)
    for row in noise:
        drawn = generator.normal(0.0, std, action_dim)
        current = np.where(generator.random(action_dim) < redraw, drawn, current)
        row[:] = current
    return noise

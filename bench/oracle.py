"""The oracle: our planner over the true simulator instead of a learned model, as what planning can reach.

Every candidate is simulated exactly, from the plant's own state and solver warm start. Plans take no time.
Letters: N candidates, H horizon, S state, A action, G goal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from mujoco import rollout as compiled_rollout
from torch import Tensor

from deploy.scores import Row
from services.planner.config import PlannerConfig
from services.planner.mpc import Mpc
from services.sim.plant import ShadowHandPlant, mujoco

rollout: Any = compiled_rollout  # without type stubs

EPISODE_STEPS = 50


@dataclass(frozen=True)
class Budget:
    """How hard the oracle searches: candidates in the first of `iterations`, `horizon` steps, `knots`."""

    candidates: int
    iterations: int
    horizon: int
    knots: int

    @property
    def name(self) -> str:
        """Such as 64x2_h16_k4."""
        return f"{self.candidates}x{self.iterations}_h{self.horizon}_k{self.knots}"

    def applied(self, config: PlannerConfig) -> PlannerConfig:
        """The planner with this budget, sampling alone: the simulator has no gradient."""
        changes = {
            "search": "icem",
            "candidates": self.candidates,
            "elites": max(2, min(config.elites, self.candidates // 4)),
            "iterations": self.iterations,
            "horizon": self.horizon,
            "knots": self.knots,
            "refine_sequences": 0,
            "refine_steps": 0,
            "propagation": "particles",
        }
        return PlannerConfig.model_validate({**config.model_dump(), **changes})


class SimulatorPredictor:
    """Where actions lead from the plant's present state, which itself stays untouched; one particle."""

    def __init__(self, plant: ShadowHandPlant, threads: int = 1) -> None:
        self._plant = plant
        self._substeps = int(plant.env.n_substeps)
        self._low, self._high = plant.model.actuator_ctrlrange.T
        self._data = [mujoco.MjData(plant.model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=0 if threads == 1 else threads)
        self._observed = _observed(plant)

    def prefix(self, state: Tensor, committed: Tensor, noise: torch.Generator | None = None) -> Tensor:
        """The present state (1, 1, 1, S). Raises ValueError for committed actions: plans take no time."""
        if len(committed):
            raise ValueError("the oracle plans from the present state: no committed actions")
        return state.expand(1, 1, 1, -1)

    def candidates(self, start: Tensor, actions: Tensor, noise: torch.Generator | None = None) -> Tensor:
        """States (H, 1, N, S) that actions (N, H, A) lead to from the plant's present state."""
        centre, half = (self._high + self._low) / 2, (self._high - self._low) / 2
        command = np.clip(centre + actions.double().numpy() * half, self._low, self._high)
        plant = self._plant
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        physics = np.empty(mujoco.mj_stateSize(plant.model, full))
        mujoco.mj_getState(plant.model, plant.data, physics, full)
        trajectories, _ = self._pool.rollout(
            plant.model,
            self._data,
            physics[None],
            np.repeat(command, self._substeps, axis=1),
            initial_warmstart=plant.data.qacc_warmstart[None],
        )
        after = trajectories[:, self._substeps - 1 :: self._substeps]
        states = after[..., self._observed].astype(np.float32)
        return torch.from_numpy(states).transpose(0, 1)[:, None].contiguous()


def _observed(plant: ShadowHandPlant) -> np.ndarray:
    """Where each state dimension (S,) stands in MuJoCo's physics state: time, qpos, qvel."""
    model = plant.model
    joints = [model.joint(f"robot0:{name}") for name in plant.task.joint_names]
    thing = model.joint("object:joint")
    qpos, qvel = 1, 1 + model.nq
    return np.concatenate(
        [
            [qpos + joint.qposadr[0] for joint in joints],
            [qvel + joint.dofadr[0] for joint in joints],
            qvel + thing.dofadr[0] + np.arange(6),
            qpos + thing.qposadr[0] + np.arange(7),
        ]
    ).astype(np.intp)


class Oracle:
    """Runs episodes of a manipulation task, planning every `x` steps on the true simulator."""

    def __init__(self, task: str, config: PlannerConfig, x: int, threads: int = 1) -> None:
        """Raises ValueError when a plan is shorter than x."""
        if config.horizon < x:
            raise ValueError(f"a horizon of {config.horizon} steps cannot fill {x}")
        self.plant = ShadowHandPlant(task)
        self._mpc = Mpc(config, self.plant.task)
        self._mpc.set_predictor(SimulatorPredictor(self.plant, threads))
        self._x = x

    def run(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """States (51, S) and actions (50, A) of the episode of `seed`; deterministic."""
        self._mpc.reset()
        states, actions = [self.plant.reset(seed).state], list[np.ndarray]()
        for action in self._actions(seed):
            actions.append(action)
            states.append(self.plant.step(action))
        return np.array(states), np.array(actions)

    def _actions(self, seed: int) -> Iterator[np.ndarray]:
        goal = torch.from_numpy(self.plant.goal.astype(np.float32))
        nothing = torch.zeros(0, self.plant.task.action_dim)
        generator = torch.Generator().manual_seed(seed)
        for k in range(0, EPISODE_STEPS, self._x):
            state = torch.from_numpy(self.plant.state.astype(np.float32))
            plan = self._mpc.plan(state, goal, nothing, EPISODE_STEPS - k, generator)
            yield from plan.actions[: min(self._x, EPISODE_STEPS - k)].double().numpy()

    def score(self, seed: int) -> Row:
        """The outcome of one episode: return, final errors and successes, as evaluations name them."""
        states, _ = self.run(seed)
        task, goal = self.plant.task, self.plant.goal
        errors = {f"error_{name}": float(value) for name, value in task.errors(states[-1], goal).items()}
        successes = {name: bool(value) for name, value in task.successes(states[-1], goal).items()}
        total = sum(float(task.env_reward(state, goal)) for state in states[1:])
        dropped = bool(np.any([task.dropped(state) for state in states]))
        return {"return": total, **errors, **successes, "dropped": dropped}

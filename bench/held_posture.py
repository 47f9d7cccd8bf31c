"""How near constant control comes to each reach goal on the true simulator, and so how near a hand can stay.

Gauss-Newton with Levenberg's damping over held postures. A lower bound on what the hand can do, since the
search is local and a moving hand may pass a contact that a held one cannot. A bound from the other side: the
collision capsules of thumb and meeting finger keep their tip sites 12.7 mm apart, while the goals are 3 to
8 mm apart. Short of interpenetration one of the two stays at least 2.2 mm off, for each of the 86 meeting
goals among 100 seeds from 1 000 000 (the other 14 ask for the start posture).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.scores import Row
from services.sim.plant import ShadowHandPlant

EPISODE_STEPS = 50

_STARTS = 3
_GOOD_ENOUGH_M = 0.0005  # mean finger error at which no other start is tried
_ITERATIONS = 12
_SETTLE_STEPS = 12  # 0.5 s: a hand at rest has settled after a small change of its targets
_PERTURBATION = 0.02
_DAMPINGS = (1e-5, 1e-4, 1e-3, 1e-2)
_LEAST_GAIN = 0.002  # relative decrease of the error below which the search stops

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """One action (A,) held for an episode: residual tips - goal (15,), m, at its end, and the return."""

    action: Floats
    residual_m: Floats
    episode_return: float

    @property
    def mean_finger_m(self) -> float:
        """Mean over fingers of the distance to the goal."""
        return float(np.linalg.norm(self.residual_m.reshape(-1, 3), axis=-1).mean())


def hold(plant: ShadowHandPlant, seed: int, action: Floats) -> Held:
    """Execute the constant `action` (A,) for an episode from the start of `seed`."""
    goal = plant.reset(seed).goal
    total = sum(float(plant.task.env_reward(plant.step(action), goal)) for _ in range(EPISODE_STEPS))
    return Held(action, plant.task.achieved(plant.state) - goal, total)


def jacobian(plant: ShadowHandPlant, action: Floats) -> Floats:
    """Change of the resting tips (15, A), m, per change of the held action, around the present posture."""
    here = plant.save()
    columns = [_settled(plant, action)]
    for joint in range(action.size):
        plant.restore(here)
        columns.append(_settled(plant, action + _inward(action, joint)))
    plant.restore(here)
    steps = [_inward(action, joint)[joint] for joint in range(action.size)]
    return (np.stack(columns[1:], axis=-1) - columns[0][:, None]) / np.array(steps)


def descend(plant: ShadowHandPlant, seed: int, start: Floats) -> Held:
    """Improve the constant action `start` (A,) for the goal of `seed` until no damping gains any more."""
    best = hold(plant, seed, start)
    for _ in range(_ITERATIONS):
        slope = jacobian(plant, best.action)
        trials = [hold(plant, seed, _damped_step(best, slope, damping)) for damping in _DAMPINGS]
        trial = min(trials, key=_error)
        if _error(trial) > (1 - _LEAST_GAIN) * _error(best):
            break
        best = hold(plant, seed, trial.action)  # leaves the plant in the best posture, for the next Jacobian
    return best


def best_hold(plant: ShadowHandPlant, seed: int) -> Held:
    """The best of up to three descents for the goal of `seed`, by mean finger error."""
    rng = np.random.default_rng(seed)
    best = descend(plant, seed, _first_posture(plant, seed))
    for _ in range(_STARTS - 1):
        if best.mean_finger_m < _GOOD_ENOUGH_M:
            break
        nearby = np.clip(best.action + rng.normal(scale=0.3, size=best.action.size), -1, 1)
        best = min(best, descend(plant, seed, nearby), key=lambda held: held.mean_finger_m)
    return best


def score(plant: ShadowHandPlant, seed: int) -> Row:
    """Find the best constant control for the goal of `seed` and measure it from a fresh start."""
    held = hold(plant, seed, best_hold(plant, seed).action)
    task, goal = plant.task, plant.goal
    errors = {f"error_{name}": float(value) for name, value in task.errors(plant.state, goal).items()}
    successes = {name: bool(value) for name, value in task.successes(plant.state, goal).items()}
    return {"return": held.episode_return, **errors, **successes, "dropped": False}


def _first_posture(plant: ShadowHandPlant, seed: int) -> Floats:
    """The action (A,) whose targets are the joint angles that the episode starts with."""
    angles = dict(zip(plant.task.joint_names, plant.reset(seed).state, strict=False))
    low, high = plant.model.actuator_ctrlrange.T
    wanted = np.array([angles[name] for name in plant.task.actuator_names])
    return np.clip((2 * wanted - high - low) / (high - low), -1, 1)


def _settled(plant: ShadowHandPlant, action: Floats) -> Floats:
    for _ in range(_SETTLE_STEPS):
        plant.step(action)
    return plant.task.achieved(plant.state)


def _inward(action: Floats, joint: int) -> Floats:
    """A perturbation (A,) of one joint that stays within [-1, 1]."""
    change = np.zeros_like(action)
    change[joint] = -_PERTURBATION if action[joint] > 0 else _PERTURBATION
    return change


def _damped_step(held: Held, slope: Floats, damping: float) -> Floats:
    normal = slope.T @ slope + damping * np.eye(held.action.size)
    return np.clip(held.action - np.linalg.solve(normal, slope.T @ held.residual_m), -1, 1)


def _error(held: Held) -> float:
    return float(np.linalg.norm(held.residual_m))

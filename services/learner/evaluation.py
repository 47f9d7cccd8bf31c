"""How good the model is on episodes that it never saw: errors over several steps, and honesty of the spread.

Letters: B members, N runs, S state, h steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from common import geometry
from common.model.dynamics import Dynamics
from common.model.masks import Masks
from common.task.layout import Group
from services.learner.replay import Replay, Split, Trajectories

HORIZONS = (1, 5, 10)


@dataclass(frozen=True)
class ModelErrors:
    """Figures per state group; empty where there are no runs long enough."""

    errors: dict[str, float]  # `<group>_h<h>`: RMSE over runs and dimensions, group's unit (rotation: rad)
    calibration: dict[str, float]  # one step, actual RMSE / predicted deviation; 1 is honest
    coverage: dict[str, float]  # `<group>_1s`, `<group>_2s`: share of dimensions within 1 and 2 deviations


@torch.no_grad()
def evaluate(
    dynamics: Dynamics,
    masks: Masks | None,
    replay: Replay,
    groups: Sequence[Group],
    *,
    split: Split = "holdout",
    limit: int = 400,
) -> ModelErrors:
    """Roll the members open-loop along recorded actions, each with one mask (B, 1, hidden), and compare.

    The prediction is the average over members, Eq. (1), taken at the end of the run.
    """
    device = dynamics.normaliser.input_mean.device
    found = ModelErrors({}, {}, {})
    for steps in HORIZONS:
        runs = replay.trajectories(steps, split, limit)
        if len(runs.states) == 0:
            continue
        runs = Trajectories(runs.states.to(device), runs.actions.to(device))
        _add_errors(found, dynamics, masks, runs, groups)
        if steps == 1:
            _add_calibration(found, dynamics, masks, runs, groups)
    return found


def rollout(dynamics: Dynamics, masks: Masks | None, state: Tensor, actions: Tensor) -> Tensor:
    """State (N, S) and actions (N, h, A) → state of each member after h steps, (B, N, S)."""
    members = dynamics.ensemble.weights[0].shape[0]
    state = state.expand(members, *state.shape)
    for step in range(actions.shape[1]):
        action = actions[:, step].expand(members, -1, -1)
        state = dynamics.predict(state, action, masks).next_state_mean
    return state


def _add_errors(
    found: ModelErrors, dynamics: Dynamics, masks: Masks | None, runs: Trajectories, groups: Sequence[Group]
) -> None:
    steps, truth = runs.actions.shape[1], runs.states[:, -1]
    predicted = rollout(dynamics, masks, runs.states[:, 0], runs.actions)
    for group in groups:
        member, true = predicted[..., group.slice], truth[..., group.slice]
        error = _angle(member, true) if group.kind == "quaternion" else member.mean(dim=0) - true
        found.errors[f"{group.name}_h{steps}"] = _rms(error)


def _add_calibration(
    found: ModelErrors, dynamics: Dynamics, masks: Masks | None, runs: Trajectories, groups: Sequence[Group]
) -> None:
    """Compare errors with the spread of the mixture: mean of variances plus variance of means."""
    members = dynamics.ensemble.weights[0].shape[0]
    state, action = runs.states[:, 0], runs.actions[:, 0]
    prediction = dynamics.predict(state.expand(members, -1, -1), action.expand(members, -1, -1), masks)
    means = prediction.change_mean
    deviation = (prediction.variance.mean(dim=0) + means.var(dim=0, correction=0)).sqrt()
    error = means.mean(dim=0) - dynamics.coordinates.change(state, runs.states[:, 1])
    for group in groups:
        part = dynamics.coordinates.part(group)
        actual, expected = error[..., part], deviation[..., part]
        found.calibration[group.name] = _rms(actual) / _rms(expected)
        for sigmas in (1, 2):
            inside = (actual.abs() <= sigmas * expected).float().mean()
            found.coverage[f"{group.name}_{sigmas}s"] = float(inside)


def _angle(predicted: Tensor, truth: Tensor) -> Tensor:
    """Rotation angle (N,) in rad between the members' mean quaternion, (B, N, 4) wxyz, and (N, 4)."""
    away = (predicted * truth).sum(dim=-1, keepdim=True) < 0
    mean = torch.where(away, -predicted, predicted).mean(dim=0)
    return geometry.angle(geometry.normalise(mean), geometry.normalise(truth))


def _rms(values: Tensor) -> float:
    return float(values.square().mean().sqrt())

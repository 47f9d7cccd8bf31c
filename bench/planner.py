"""How fast the planner plans, as ratios in one run: `python -m bench.planner [--json] [--preset NAME]`.

roofline_fraction: floating-point operations of the executed layers, over the time spent in the model, over
the ceiling rate of the same products. whole_plan_fraction: the same over the whole plan's time.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from bench.roofline import CeilingResult, Shape, ceiling, clock, flops, torch_threads
from common.model.choose import coordinates_of
from common.model.config import ModelConfig
from common.model.dynamics import Dynamics
from common.model.masks import MaskPool
from common.model.normaliser import Normaliser
from common.task import Task, get_task
from services.planner.config import PlannerConfig
from services.planner.mpc import Mpc, Plan
from services.planner.particles import Layer, Network, Particles, particles

ResultT = TypeVar("ResultT")

# `reach` is the planner section of cell `reach`.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "reach": {"preset": "fast", "search": "none"},
    "paper": {"preset": "paper"},
}
_EPISODE_STEPS = 50
_AHEAD = 2
_WARM_UP = 1
_COMPARED_STEPS = 5


@dataclass
class Account:
    """Products that a plan executed, by shape, and the seconds spent in the model."""

    now: Callable[[], float]
    products: Counter[Shape] = field(default_factory=Counter[Shape])
    seconds: float = 0.0

    def timed(self, work: Callable[[], ResultT]) -> ResultT:
        start = self.now()
        result = work()
        self.seconds += self.now() - start
        return result

    @property
    def flops(self) -> int:
        return sum(count * flops(shape) for shape, count in self.products.items())


class AccountedNetwork(Network):
    """A network that books its products and its time."""

    def __init__(self, layers: Sequence[Layer], account: Account) -> None:
        super().__init__(layers)
        self._account = account

    def evaluate(self, x: Tensor, first: Layer | None = None) -> Tensor:
        self._book(x.shape[1], self.layers if first is None else (first, *self.layers[1:]))
        return self._account.timed(lambda: super(AccountedNetwork, self).evaluate(x, first))

    def evaluate_saving(self, x: Tensor) -> tuple[Tensor, list[Tensor]]:
        self._book(x.shape[1], self.layers)
        return self._account.timed(lambda: super(AccountedNetwork, self).evaluate_saving(x))

    def pull_back(self, gradient: Tensor, saved: Sequence[Tensor]) -> Tensor:
        self._book(gradient.shape[1], self.layers, transposed=True)
        return self._account.timed(lambda: super(AccountedNetwork, self).pull_back(gradient, saved))

    def _book(self, N: int, layers: Sequence[Layer], transposed: bool = False) -> None:
        for layer in layers:
            P, K, J = layer.weight.shape
            self._account.products[(P, N, J, K) if transposed else (P, N, K, J)] += 1


@dataclass(frozen=True)
class Setting:
    """A planning problem of the task's size; the model's weights are random, which costs the same."""

    config: PlannerConfig
    task: Task
    dynamics: Dynamics
    pool: MaskPool
    states: Tensor  # and goals of each step, unrelated: a warm start would leave nothing to improve
    goals: Tensor
    committed: Tensor

    @staticmethod
    def create(config: PlannerConfig, task: Task, seed: int = 0) -> Setting:
        """Model of the paper's size (B 5, 3 x 512), states, goals and committed actions drawn from `seed`."""
        generator = torch.Generator().manual_seed(seed)
        model = ModelConfig()
        coordinates = coordinates_of(model.coordinates, task)
        normaliser = Normaliser.identity(coordinates.inputs, coordinates.changes)
        return Setting(
            config,
            task,
            Dynamics.create(model, normaliser, coordinates, generator),
            MaskPool.draw(model.members, model.plan_masks, model.hidden, model.dropout, generator),
            0.1 * torch.rand(_EPISODE_STEPS, task.state_dim, generator=generator).to(config.device),
            torch.rand(_EPISODE_STEPS, task.goal_dim, generator=generator).to(config.device),
            torch.zeros(_AHEAD, task.action_dim, device=config.device),
        )

    def particles(self, account: Account) -> Particles:
        """The planner's model, booking into `account`."""
        config = self.config
        model = particles(self.dynamics, self.pool, config.members, config.masks, device=config.device)
        model.network = AccountedNetwork(model.network.layers, account)
        return model

    def planner(self, account: Account) -> Callable[[int], Plan]:
        """Plans at step k of an episode, each for a goal of its own."""
        mpc = Mpc(self.config, self.task)
        mpc.set_model(self.particles(account))
        generator = torch.Generator(self.config.device).manual_seed(1)
        left = _EPISODE_STEPS
        return lambda k: mpc.plan(self.states[k], self.goals[k], self.committed, left - k, generator)


class _Timed(NamedTuple):
    """One plan: its seconds, those in the model, and the products' floating-point operations."""

    seconds: float
    seconds_in_model: float
    flops: int


def measure(setting: Setting, plans: int) -> dict[str, object]:
    """The figures of `plans` plans, and the ceiling for the same products measured right after."""
    config = setting.config
    now = clock(config.device, config.threads)
    account = Account(_synchronised(now, config.device))
    plan = setting.planner(account)
    timed = [_timed_plan(plan, k, account) for k in range(_WARM_UP + plans)][_WARM_UP:]
    seconds = sorted(each.seconds for each in timed)
    top, middle = _ceiling(account, config), median(seconds)
    return {
        "roofline_fraction": median(each.flops / each.seconds_in_model for each in timed) / 1e9 / top.gflops,
        "whole_plan_fraction": median(each.flops / each.seconds for each in timed) / 1e9 / top.gflops,
        "plans_per_s": 1.0 / middle,
        "plan_ms_p50": 1e3 * middle,
        "plan_ms_p99": 1e3 * seconds[min(len(seconds) - 1, round(0.99 * len(seconds)))],
        "gflop_per_plan": median(each.flops for each in timed) / 1e9,
        "ceiling_gflops": top.gflops,
        "speedup_vs_member_loop": _speedup(setting),
        "clock": now.__name__,
        "settings": config.model_dump(mode="json"),
        "ceiling": top.as_json(),
    }


def _timed_plan(plan: Callable[[int], Plan], k: int, account: Account) -> _Timed:
    start, inside, work = account.now(), account.seconds, account.flops
    plan(k % _EPISODE_STEPS)
    return _Timed(account.now() - start, account.seconds - inside, account.flops - work)


def _ceiling(account: Account, config: PlannerConfig) -> CeilingResult:
    shapes, counts = zip(*account.products.items(), strict=True)
    return ceiling(shapes, config.threads, config.device, counts)


def _speedup(setting: Setting, repeats: int = 3) -> float:
    """Time of one batch of rollouts by a loop over members of nn.Linear, over ours."""
    config = setting.config
    now = _synchronised(clock(config.device, config.threads), config.device)
    model = setting.particles(Account(now))
    steps = min(config.horizon, _COMPARED_STEPS)
    members = [_plain_member(setting) for _ in range(model.particles)]
    actions = torch.zeros(config.candidates, steps, setting.task.action_dim, device=config.device)
    start = setting.states[0].expand(model.particles, 1, -1)

    def ours() -> None:
        state = start
        for action in actions.unbind(1):
            state = model.step(state, action)

    def plain() -> None:
        for member in members:
            state = setting.states[0].expand(config.candidates, -1)
            for action in actions.unbind(1):
                state = state + member(torch.cat((state, action), -1))[:, : state.shape[1]]

    return _best_of(plain, now, repeats) / _best_of(ours, now, repeats)


def _plain_member(setting: Setting) -> nn.Module:
    task = setting.task
    sizes = ModelConfig().layer_sizes(task.state_dim + task.action_dim, 2 * task.state_dim)
    layers: list[nn.Module] = []
    for fan_in, fan_out in sizes:
        layers += [nn.Linear(fan_in, fan_out), nn.SiLU()]
    return nn.Sequential(*layers[:-1]).to(setting.config.device)


def _best_of(work: Callable[[], None], now: Callable[[], float], repeats: int) -> float:
    times: list[float] = []
    with torch.no_grad():
        for _ in range(1 + repeats):
            start = now()
            work()
            times.append(now() - start)
    return min(times[1:])


def _synchronised(now: Callable[[], float], device: str) -> Callable[[], float]:
    if not device.startswith("cuda"):
        return now

    def synchronised() -> float:
        torch.cuda.synchronize(device)
        return now()

    return synchronised


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m bench.planner")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="reach")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--plans", type=int, default=50, help="plans measured")
    options = parser.parse_args(arguments)
    config = PlannerConfig(**PRESETS[options.preset], device=options.device, threads=options.threads)
    with torch_threads(config.threads):
        result = measure(Setting.create(config, get_task("reach")), options.plans)
    if options.json:
        print(json.dumps(result))
    else:
        print(
            "\n".join(f"{name:24} {value:.3g}" for name, value in result.items() if isinstance(value, float))
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""How fast the learner trains: `python -m bench.learner` prints one JSON object, all measured in one run.

roofline_fraction = arithmetic rate of whole gradient steps / ceiling rate of their matrix products.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from bench.roofline import CeilingResult, Shape, ceiling, flops, seconds_per_call, torch_threads
from common.model.choose import coordinates_of
from common.model.config import ModelConfig
from common.task import Task, get_task
from services.learner.backprop import keep_freed_memory
from services.learner.config import LearnerConfig
from services.learner.episode import Episode
from services.learner.replay import Replay
from services.learner.trainer import Trainer

EPISODES, STEPS = 100, 50  # the paper's warm-up: 5000 random samples
SCHEDULE_END = 1_000_000  # more gradient steps than the bench takes


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    task: str
    batch: int
    updates: int
    rounds: int
    device: str
    threads: int


def main(arguments: Sequence[str] | None = None) -> None:
    settings, as_json = _parse(arguments)
    result = measure(settings)
    if as_json:
        print(json.dumps(result))
    else:
        print(json.dumps(result, indent=2))


def measure(settings: Settings) -> dict[str, object]:
    """Ceiling, batched learner and member loop in turn, `rounds` times; medians of the ratios."""
    task = get_task(settings.task)
    model = ModelConfig()
    counts = matmuls(model, task, settings.batch)
    replay = random_replay(task)
    batched = [_trainer(task, model, settings, seed=0)]
    alone = model.model_copy(update={"members": 1})
    looped = [_trainer(task, alone, settings, seed) for seed in range(model.members)]
    keep_freed_memory()  # as the learner's process does
    with torch_threads(settings.threads):
        for trainer in (*batched, *looped):
            trainer.begin(replay, SCHEDULE_END)
        rounds = [_round(settings, counts, replay, batched, looped) for _ in range(settings.rounds)]
    work = sum(count * flops(shape) for shape, count in counts.items())
    return _summary(settings, model, rounds, work)


def matmuls(model: ModelConfig, task: Task, batch: int) -> Counter[Shape]:
    """Matrix products (B, N, K, J) of one gradient step of Eq. (4), forward and backward of both steps.

    The first layer of step 1 needs no gradient of its input; step 2 does, since step 1 made that input.
    """
    coordinates, B, N = coordinates_of(model.coordinates, task), model.members, batch
    counts: Counter[Shape] = Counter()
    for layer, (fan_in, fan_out) in enumerate(model.layer_sizes(coordinates.inputs, 2 * coordinates.changes)):
        counts[B, N, fan_in, fan_out] += 2  # forward
        counts[B, fan_in, N, fan_out] += 2  # gradient of the weights
        counts[B, N, fan_out, fan_in] += 2 if layer > 0 else 1  # gradient of the input
    return counts


def random_replay(task: Task) -> Replay:
    """Noise of the task's shape: the time of a gradient step does not depend on what it learns."""
    rng = np.random.default_rng(0)
    replay = Replay(task.state_dim, task.action_dim)
    for number in range(EPISODES):
        states = rng.normal(size=(STEPS + 1, task.state_dim)).astype(np.float32)
        actions = rng.uniform(-1, 1, (STEPS, task.action_dim)).astype(np.float32)
        goal, valid = np.zeros(task.goal_dim, np.float32), np.ones(STEPS + 1, np.bool_)
        replay.add(Episode(1, number, "random", states, actions, goal, valid))
    return replay


@dataclass(frozen=True)
class Round:
    """One turn of the three measurements; seconds of one gradient step of all members."""

    limit: CeilingResult
    batched_s: float
    looped_s: float


def _round(
    settings: Settings,
    counts: Counter[Shape],
    replay: Replay,
    batched: Sequence[Trainer],
    looped: Sequence[Trainer],
) -> Round:
    limit = ceiling(list(counts), settings.threads, settings.device, list(counts.values()), repeats=3)
    return Round(limit, _seconds(settings, replay, batched), _seconds(settings, replay, looped))


def _seconds(settings: Settings, replay: Replay, trainers: Sequence[Trainer]) -> float:
    def step() -> None:
        for trainer in trainers:
            trainer.train_slice(replay, settings.updates)

    taken = seconds_per_call(step, settings.device, settings.threads, repeats=7)
    return taken / settings.updates


def _trainer(task: Task, model: ModelConfig, settings: Settings, seed: int) -> Trainer:
    return Trainer(LearnerConfig(batch=settings.batch), model, task, seed, settings.device)


def _summary(settings: Settings, model: ModelConfig, rounds: Sequence[Round], work: int) -> dict[str, object]:
    def median(values: Sequence[float]) -> float:
        return round(statistics.median(values), 4)

    step_s = [each.batched_s for each in rounds]
    return {
        "roofline_fraction": median([work / r.batched_s / 1e9 / r.limit.gflops for r in rounds]),
        "updates_per_s": median([1 / seconds for seconds in step_s]),
        "gflops": median([work / seconds / 1e9 for seconds in step_s]),
        "ceiling_gflops": median([r.limit.gflops for r in rounds]),
        "speedup_vs_member_loop": median([r.looped_s / r.batched_s for r in rounds]),
        "gflop_per_update": round(work / 1e9, 3),
        "ceiling": rounds[0].limit.as_json(),
        "settings": vars(settings) | {"model": model.model_dump(mode="json"), "torch": torch.__version__},
    }


def _parse(arguments: Sequence[str] | None) -> tuple[Settings, bool]:
    parser = argparse.ArgumentParser(prog="python -m bench.learner", description=__doc__)
    parser.add_argument("--task", default="reach", help="its state and action sizes are measured")
    parser.add_argument("--batch", type=int, default=256, help="windows a member")
    parser.add_argument("--updates", type=int, default=5, help="gradient steps between two clock readings")
    parser.add_argument("--rounds", type=int, default=5, help="turns of ceiling, learner and member loop")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1, help="on the CPU")
    parser.add_argument("--json", action="store_true", help="on one line")
    given = vars(parser.parse_args(arguments))
    as_json = given.pop("json")
    return Settings(**given), as_json


if __name__ == "__main__":
    main()

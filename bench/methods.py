"""The compared methods: named differences from a cell, and the configuration that a run ends up with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bench.agents import agent_cell
from common.config import ConfigError, parse
from deploy.cell import Cell, method_problems
from deploy.cell_files import find_cell, read_cell
from deploy.supervisor import REPOSITORY


@dataclass(frozen=True)
class Method:
    """What is different from the cell, as `--set` writes it."""

    about: str
    overrides: tuple[str, ...] = ()
    agent: bool = False  # one of bench.agents, in place of planner and learner


# An agent decides while the plant stands still, so x is 1: an advantage over the asynchronous methods.
_AGENT = ("control.synchronous=true", "control.steps_per_plan=1")

_PAPER = (
    "planner={preset: paper}",
    "learner={}",
    "model={}",
    "curriculum.warmup=uniform",
    "control.start=zero",
    "control.chunk=x",
)
# The paper's 20 particles and 500 x 5 candidates would take a core 25 s a plan: a thirtieth of that work.
_CPU_BUDGET = ("planner.masks=1", "planner.candidates=64", "planner.elites=6")

# PETS and DPETS keep the cell's networks, warm-up, horizon and knots, so that what differs is the method:
# their planner is CEM, here of 200 x 5 candidates. Both plan synchronously, as published: in lock-step the
# plant stands still meanwhile, which favours them.
_CEM = (
    "planner.search=cem",
    "planner.candidates=200",
    "planner.elites=20",
    "planner.iterations=5",
    "planner.refine_steps=0",
)
_WITHOUT_OURS = (
    "model.coordinates=raw",
    "learner.loss.beta_nll=0",
    "planner.stray_weight=0",
    "planner.sink_weight=0",
    "planner.correction=0",
    "planner.tail_steps=0",
    "learner.loss.target_bound=0",
)
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "gc_pmpc_plus": Method("the cell as it is"),
        "gc_pmpc": Method(
            "the paper's loss, horizon 50 and CEM; 5 particles, 64 x 5 candidates: a plan takes a core 0.8 s",
            (*_PAPER, "model.targets=standardised", *_CPU_BUDGET),
        ),
        "gc_pmpc_paper": Method("the paper's values throughout, none of the cell's", _PAPER),
        "dpets": Method(
            "raw state, no normalisation, no variance penalty, no smoothing, CEM, synchronous",
            (
                *_WITHOUT_OURS,
                "learner.loss.second_step=true",
                "model.normalise=false",
                "model.targets=raw",
                "learner.loss.variance_penalty=0",
                "planner.smooth_weight=0",
                "control.synchronous=true",
                *_CEM,
            ),
        ),
        "pets": Method(
            "raw state, one-step likelihood, no Dropout, sampled particles, CEM, synchronous",
            (
                *_WITHOUT_OURS,
                "model.dropout=0",
                "learner.loss.second_step=false",
                "learner.loss.variance_penalty=0",
                "planner.masks=1",
                "planner.propagation=sampled",
                "planner.smooth_weight=0",
                "control.synchronous=true",
                *_CEM,
            ),
        ),
        "no_normalisation": Method(
            "raw inputs and targets (Eq. 3 without BN)", ("model.normalise=false", "model.targets=raw")
        ),
        "no_penalty": Method("Eq. (4) without term 3", ("learner.loss.variance_penalty=0",)),
        "one_step": Method("Eq. (4) without term 2", ("learner.loss.second_step=false",)),
        "no_smoothing": Method("Eq. (5) without the smoothing term", ("planner.smooth_weight=0",)),
        "printed_smoothing": Method("Eq. (5) with the printed sign", ("planner.smooth_sign=printed",)),
        "no_correction": Method("predictions as the model makes them", ("planner.correction=0",)),
        "no_dropout": Method("no Dropout particles", ("model.dropout=0", "planner.masks=1")),
        "synchronous": Method("textbook MPC: the plant waits for each plan", ("control.synchronous=true",)),
        "x4": Method(
            "x = 4: a plan takes nearly four control steps, and looks beyond the four under way",
            ("control.steps_per_plan=4", "planner.declared_solve_ms=150", "planner.horizon=8"),
        ),
        "average": Method(
            "particles averaged at each step (Eq. 1 as printed)", ("planner.propagation=average",)
        ),
        "sac": Method("soft actor-critic, model-free", _AGENT, agent=True),
        "ddpg_her": Method("DDPG with hindsight experience replay, model-free", _AGENT, agent=True),
        "td7": Method("TD3 with state-action embeddings, model-free", _AGENT, agent=True),
        "tdmpc": Method("latent model with value and policy, planned by MPPI", _AGENT, agent=True),
    }
)


def configure(cell: str, method: str, overrides: Iterable[str], run_dir: Path) -> Cell:
    """Return the configuration of a run: the cell, the method's differences, then `overrides`.

    Raises ConfigError listing every mistake.
    """
    if method not in METHODS:
        raise ConfigError([f"{method}: no such method; choose one of {', '.join(METHODS)}"])
    path = find_cell(cell)
    data = read_cell(path, (*METHODS[method].overrides, *overrides))
    if METHODS[method].agent:
        data["agent_method"] = method
    return cell_of(data, path.name, run_dir)


def cell_of(data: dict[str, Any], source: str, run_dir: Path) -> Cell:
    """Check a configuration for lock-step, where alone control may be synchronous. Raises ConfigError."""
    control = data.get("control")
    control = dict(control) if isinstance(control, dict) else {}
    synchronous = bool(control.pop("synchronous", False))
    data = {**data, "control": control, "config_hash": ""}
    cell = agent_cell(data, source) if "agent_method" in data else parse(Cell, data, source)
    problems = [f"{source}: {problem}" for problem in method_problems(cell)]
    if problems:
        raise ConfigError(problems)
    changed = {"control": cell.control.model_copy(update={"synchronous": synchronous}), "run_dir": run_dir}
    cell = cell.model_copy(update=changed)
    glove = cell.glove.within(REPOSITORY)
    return cell.model_copy(update={"config_hash": cell.hash(), "glove": glove})

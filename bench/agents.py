"""The compared methods that are no configuration of ours: which there are, their settings, their service."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from pydantic import Field

from bench.agent_service import AgentService
from bench.agent_worker import CHECKPOINT, AgentWorker, read_checkpoint
from bench.baselines.controller import Controller
from common.built import Built
from common.config import ConfigError, Frozen, parse
from common.task import Task, get_task
from deploy.cell import Cell

# Method → module, each with a `Config` and an `Agent`; loaded when chosen, for not everybody has the extra.
AGENTS: Mapping[str, str] = MappingProxyType(
    {
        "sac": "bench.baselines.sac",
        "ddpg_her": "bench.baselines.ddpg_her",
        "td7": "bench.baselines.td7",
        "tdmpc": "bench.baselines.tdmpc",
    }
)
_DIRECTORY = "learner"  # episodes and checkpoint are where a learner keeps its own


class AgentCell(Cell):
    """A cell in which one of AGENTS takes the place of planner and learner."""

    agent_method: str
    agent: dict[str, Any] = Field(
        default={}, description="settings of the method; defaults are published ones"
    )


@dataclass(frozen=True)
class AgentModel:
    """A trained agent, ready to act."""

    method: str
    updates: int
    episodes: int  # that it has seen, warm-up included
    controller: Controller

    @property
    def id(self) -> str:
        """What rows call it."""
        return f"{self.method}-{self.updates}"


def agent_cell(data: Mapping[str, Any], source: str) -> AgentCell:
    """Check a cell with `agent_method` and fill its settings in. Raises ConfigError listing every mistake."""
    cell = parse(AgentCell, data, source)
    settings = parse(_module(cell.agent_method).Config, cell.agent, f"{source}: agent")
    return cell.model_copy(update={"agent": settings.model_dump(mode="json")})


def build(cell: AgentCell, boot_id: int, model: AgentModel | None = None) -> Built:
    """Make the service; `model` acts and learns nothing more. Raises ConfigError if run_dir is another's."""
    task = get_task(cell.task)
    controller, worker = model.controller if model else _controller(cell, task), None
    if model is None:
        worker = AgentWorker(
            cell.run_dir / _DIRECTORY,
            task,
            controller,
            identity=_identity(cell),
            seed=cell.seed,
            warmup_steps=cell.warmup_steps,
        )
    service = AgentService(
        controller,
        worker,
        boot_id,
        method=cell.agent_method,
        seed=cell.seed,
        decide_ns=cell.control.period_ns,
        updates=model.updates if model else 0,
    )
    return Built(service)


def load_agent(cell: AgentCell, run: Path) -> AgentModel:
    """Read what a run has learned last. Raises ConfigError when there is nothing."""
    controller = _controller(cell, get_task(cell.task))
    tensors, (updates, _, episodes, _) = read_checkpoint(run / _DIRECTORY / CHECKPOINT, _identity(cell))
    controller.restore(tensors)
    return AgentModel(cell.agent_method, updates, episodes, controller)


def _controller(cell: AgentCell, task: Task) -> Controller:
    module = _module(cell.agent_method)
    make = cast(Callable[[Frozen, Task, int], Controller], module.Agent)
    return make(module.Config(**cell.agent), task, cell.seed)


def _module(method: str) -> Any:
    if method not in AGENTS:
        raise ConfigError([f"{method}: no such agent; choose one of {', '.join(AGENTS)}"])
    try:
        return import_module(AGENTS[method])
    except ModuleNotFoundError as error:
        raise ConfigError(
            [f"{method} needs {error.name}: install the extra with `pip install -e .[baselines]`"]
        ) from None


def _identity(cell: AgentCell) -> str:
    """What a checkpoint must agree with."""
    return json.dumps([cell.task, cell.seed, cell.agent_method, cell.agent], sort_keys=True)

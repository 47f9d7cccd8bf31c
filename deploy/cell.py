"""A cell: one YAML with the sections of all processes, checked as a whole and rendered for each of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, model_validator

from common.camera_config import CameraConfig
from common.can_config import CanConfig
from common.cell import SharedConfig
from common.config import ConfigError, Frozen, digest, parse
from common.dexhand021.config import NO_CURRENT_LIMIT, DexHandConfig
from common.dexhand021.glove_config import GloveConfig
from common.hand_messages import PoseSource
from common.model.config import ModelConfig
from common.task import DieTask, get_die_task, get_task
from deploy.cell_files import find_cell, read_cell
from deploy.curriculum_config import CurriculumConfig
from deploy.processes import NAMES, WATCHDOG, PlantKind, process_of, processes_of
from deploy.supervisor import REPOSITORY, RunFiles, check_paths
from deploy.viewer.config import ViewerConfig
from deploy.watchdog_config import WatchdogConfig
from services.hand_io.config import HandIoConfig
from services.learner.config import LearnerConfig
from services.perception.config import PerceptionConfig
from services.planner.config import PlannerConfig
from services.sim.dexhand_physics import TwinPhysics
from services.sim.emulator_config import EmulatorConfig

ALL_LOCAL = "local"
ROUTER_PORT = 7447
# What a run cannot change when it is taken up again: its stored episodes and weights would not fit.
FIXED = ("task", "seed", "model")


class Machine(Frozen):
    """A computer of the cell and what runs on it."""

    address: str = Field(min_length=1, description="host name or address under which the others reach it")
    services: tuple[str, ...] = Field(min_length=1, description="names from the process table")


class Cell(SharedConfig):
    """Everything that one hand, its model and its operator need to know."""

    # Resolved by read_cell before a cell is checked, and no part of what is written or hashed.
    base: str = Field(
        default="",
        exclude=True,
        description="cell that this one starts from: a shipped one's name, or a file, meant from this one's "
        "folder; in cell files only",
    )
    model: ModelConfig = ModelConfig()
    planner: PlannerConfig = PlannerConfig()
    learner: LearnerConfig = LearnerConfig()
    curriculum: CurriculumConfig = CurriculumConfig()
    viewer: ViewerConfig = ViewerConfig()
    watchdog: WatchdogConfig = WatchdogConfig()
    plant: PlantKind = Field(
        default="sim",
        description="sim: all in simulation; twin: hand_io drives an emulated hand; hand: a real one",
    )
    can: CanConfig = CanConfig()
    hand: DexHandConfig = DexHandConfig()
    hand_io: HandIoConfig = HandIoConfig()
    glove: GloveConfig = GloveConfig()
    emulator: EmulatorConfig = EmulatorConfig()
    twin: TwinPhysics = TwinPhysics()
    camera: CameraConfig = CameraConfig()
    perception: PerceptionConfig = PerceptionConfig()
    pose_source: PoseSource = Field(default=PoseSource.TWIN, description="who tells where the die is")
    machines: dict[str, Machine] = Field(default={}, description="empty: everything runs on one machine")

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        """Let values that follow from others default to them."""
        if not isinstance(data, Mapping):
            return data
        return {"run_dir": f"runs/{data.get('cell', 'reach')}", **_router_address(data), **data}

    def hash(self) -> str:
        """Digest of everything but the places of results and recordings."""
        glove = self.glove.without_places()
        return digest(self.model_copy(update={"run_dir": Path(), "config_hash": "", "glove": glove}))


def _router_address(data: Mapping[str, Any]) -> dict[str, Any]:
    """Place the bus at the machine of the router, when the cell names machines but no bus."""
    for machine in (data.get("machines") or {}).values():
        if isinstance(machine, Mapping) and "router" in machine.get("services", ()) and "address" in machine:
            endpoint = f"tcp/{machine['address']}:{ROUTER_PORT}"
            return {"bus": {"connect": [endpoint], "listen": [endpoint]}}
    return {}


def method_problems(cell: Cell) -> Iterable[str]:
    """What the sections about the method, each valid by itself, contradict each other in."""
    control, planner, model = cell.control, cell.planner, cell.model
    x = control.steps_per_plan
    if control.synchronous:
        yield "control.synchronous: only for lock-step runs; live, the plant does not wait for the planner"
    if isinstance(x, int) and planner.horizon <= x:
        yield f"planner.horizon ({planner.horizon}) must exceed control.steps_per_plan ({x})"
    if planner.members > model.members:
        yield f"planner.members ({planner.members}) exceed model.members ({model.members})"
    if planner.masks > model.plan_masks:
        yield f"planner.masks ({planner.masks}) exceed model.plan_masks ({model.plan_masks})"
    if len(cell.learner.loss.decay) != len(model.hidden) + 1:
        yield f"learner.loss.decay: {len(model.hidden) + 1} values wanted, one per layer of model.hidden"
    if cell.curriculum.goal_faces and not isinstance(get_task(cell.task), DieTask):
        yield f"curriculum.goal_faces: task {cell.task} has no die"
    groups = [group.name for group in get_task(cell.task).groups]
    for name in cell.learner.loss.group_weights:
        if name not in groups:
            has = ", ".join(groups)
            yield f"learner.loss.group_weights: no group {name} in task {cell.task}; it has {has}"
    if cell.curriculum.warmup == "glove" and not cell.glove.sources:
        yield "curriculum.warmup: glove wants recordings: name them in glove.sources"
    if cell.glove.sources and not isinstance(get_task(cell.task), DieTask):
        yield f"glove.sources: no glove fits the hand of task {cell.task}, the DexHand 021's alone"


def _hand_problems(cell: Cell) -> Iterable[str]:
    if cell.plant == "sim":
        return
    try:
        get_die_task(cell.task, cell.hand.hand)
    except ValueError as error:
        yield str(error)
    if cell.can.interface == "virtual":
        yield "can.interface: virtual is a bus within one process, and a cell has several: udp_multicast"
    if cell.plant == "twin" and not cell.can.simulated:
        yield f"can.interface: an emulated hand has no place on {cell.can.interface}"
    if cell.plant == "hand" and cell.pose_source is PoseSource.TWIN:
        yield "pose_source: only an emulated hand has a twin that knows where the die is"
    if cell.hand_io.auto_arm and not cell.can.simulated:
        yield "hand_io.auto_arm: a hand that can hurt is armed by a person (deploy.arm)"
    if not (cell.hand.limits_current or cell.can.simulated):
        yield NO_CURRENT_LIMIT


def _machine_problems(cell: Cell) -> Iterable[str]:
    machines = cell.machines
    counts = Counter(name for machine in machines.values() for name in machine.services)
    for name in counts:
        if name not in NAMES:
            yield f"machines: {name} is no service; choose from {' '.join(NAMES)}"
        elif counts[name] > 1 and name != WATCHDOG:
            yield f"machines: {name} runs on {counts[name]} machines; it must be on one"
    wanted = processes_of(cell.plant, cell.pose_source)
    missing = [process.name for process in wanted if process.required and process.name not in counts]
    if machines and missing:
        yield f"machines: {' '.join(missing)} runs on no machine"
    if ALL_LOCAL in machines:
        yield f"machines: the name {ALL_LOCAL} is taken; it means everything on one machine"


def load_cell(text: str, overrides: Iterable[str] = ()) -> Cell:
    """Read a cell and check its parts against each other; relative paths are meant from the repository.

    Raises ConfigError with one line per mistake.
    """
    path = find_cell(text)
    cell = parse(Cell, read_cell(path, overrides), path.name)
    problems = [*method_problems(cell), *_hand_problems(cell), *_machine_problems(cell)]
    if problems:
        raise ConfigError([f"{path.name}: {problem}" for problem in problems])
    return cell.model_copy(
        update={
            "run_dir": (REPOSITORY / cell.run_dir).resolve(),
            "glove": cell.glove.within(REPOSITORY),
            "config_hash": cell.hash(),
        }
    )


def on_this_machine(cell: Cell) -> Cell:
    """Return the cell with all services here: its bus keeps its ports but never leaves this machine."""
    local: dict[str, Any] = {
        "connect": tuple(map(_loopback, cell.bus.connect)),
        "listen": tuple(map(_loopback, cell.bus.listen)),
        "bind": "",
    }
    moved = cell.model_copy(update={"machines": {}, "bus": cell.bus.model_copy(update=local)})
    return moved.model_copy(update={"config_hash": moved.hash()})


def _loopback(endpoint: str) -> str:
    protocol, _, rest = endpoint.partition("/")
    return (
        f"{protocol}/127.0.0.1:{rest.rpartition(':')[2]}" if protocol in ("tcp", "udp", "tls") else endpoint
    )


def instances_of(cell: Cell, machine: str) -> tuple[str, ...]:
    """Name the processes of one machine in order of start. Raises ConfigError for an unknown machine."""
    names = tuple(process.name for process in processes_of(cell.plant, cell.pose_source))
    if machine == ALL_LOCAL:
        return names
    if machine not in cell.machines:
        known = " ".join(cell.machines) or "none: leave the machine out"
        raise ConfigError([f"{machine}: no such machine in cell {cell.cell}; its machines: {known}"])
    services = cell.machines[machine].services
    return tuple(f"{name}_{machine}" if name == WATCHDOG else name for name in names if name in services)


def process_config(cell: Cell, instance: str, machine: str = ALL_LOCAL) -> dict[str, Any]:
    """Return what the YAML of one process holds: what all share, and its own sections."""
    names = (*SharedConfig.model_fields, *process_of(instance).sections)
    data = cell.model_dump(mode="json", include=set(names))
    data["bus"]["bind"] = _bind(cell, machine)
    if process_of(instance).name == WATCHDOG:
        watches = [n for n in instances_of(cell, machine) if process_of(n).watchdog_restarts]
        own = {"name": instance, "socket": str(RunFiles(cell.run_dir, machine).socket), "watches": watches}
        data["watchdog"] |= own
    return data


def _bind(cell: Cell, machine: str) -> str:
    """Dial out from the machine's own address, unless the cell says otherwise."""
    if machine == ALL_LOCAL or cell.bus.bind:
        return cell.bus.bind
    return f"{cell.machines[machine].address}:0"


def write_process_configs(cell: Cell, machine: str = ALL_LOCAL) -> RunFiles:
    """Write the effective cell and one file per process of the machine into the run directory.

    Raises ConfigError when the run directory holds a run that this cell cannot continue.
    """
    files = RunFiles(cell.run_dir, machine)
    check_paths(files)
    _check_same_run(cell, files)
    for directory in (files.config_dir, files.log_dir):
        directory.mkdir(parents=True, exist_ok=True)
    for instance in instances_of(cell, machine):
        _write(files.config_of(instance), process_config(cell, instance, machine))
    _write(files.config_of("cell"), cell.model_dump(mode="json"))
    return files


def _check_same_run(cell: Cell, files: RunFiles) -> None:
    try:
        before = yaml.safe_load(files.config_of("cell").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return
    now = cell.model_dump(mode="json")
    changed = [name for name in FIXED if before.get(name) != now[name]]
    if changed:
        raise ConfigError(
            [
                f"{cell.run_dir}: holds a run with another {' and '.join(changed)}: delete that folder, "
                "or take another with `--set run_dir=runs/NAME`"
            ]
        )


def _write(path: Path, data: Mapping[str, Any]) -> None:
    path.write_text(yaml.safe_dump(dict(data), sort_keys=False), encoding="utf-8")

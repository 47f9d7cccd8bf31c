from importlib import import_module
from pathlib import Path

import pytest
import yaml

from common.cell import SharedConfig
from common.config import ConfigError, parse
from deploy import config
from deploy.cell import (
    instances_of,
    load_cell,
    on_this_machine,
    process_config,
    write_process_configs,
)
from deploy.cell_files import CELLS_DIR, find_cell
from deploy.processes import NAMES, process_of, processes_of
from services.hand_io.config import HandIoProcess

IN_SIMULATION = tuple(process.name for process in processes_of("sim"))
SHIPPED = sorted(path.stem for path in CELLS_DIR.glob("*.yaml"))
MODELS = {
    "sim": ("services.sim.build", "SimProcess"),
    "emulator": ("services.sim.emulator_config", "EmulatorProcess"),
    "hand_io": ("services.hand_io.config", "HandIoProcess"),
    "camera": ("services.sim.twin_camera", "TwinCameraProcess"),
    "perception": ("services.perception.config", "PerceptionProcess"),
    "planner": ("services.planner.build", "PlannerProcess"),
    "learner": ("services.learner.build", "LearnerProcess"),
    "viewer": ("deploy.viewer.build", "ViewerProcess"),
    "watchdog": ("deploy.watchdog", "WatchdogProcess"),
    "curriculum": ("deploy.curriculum_config", "CurriculumProcess"),
}


def write(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_shipped_cells_are_the_promised_ones() -> None:
    assert SHIPPED == [
        "block",
        "debug",
        "dexhand_camera",
        "dexhand_twin",
        "die",
        "egg",
        "egg_rotate",
        "reach",
        "three_machines",
    ]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_cells_are_valid_and_named_after_their_files(name: str) -> None:
    assert load_cell(name).cell == name


@pytest.mark.parametrize("name", NAMES)
def test_every_process_accepts_what_is_rendered_for_it(name: str) -> None:
    module, model = MODELS.get(name, ("common.cell", "SharedConfig"))
    wanted = getattr(import_module(module), model)
    parsed = parse(wanted, process_config(load_cell("debug"), name), source=name)
    assert isinstance(parsed, SharedConfig)
    assert parsed.config_hash == load_cell("debug").config_hash


def test_three_mistakes_give_three_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = write(
        tmp_path / "typo.yaml",
        "bus:\n  conect: [tcp/127.0.0.1:7447]\nseed: many\nlearner:\n  batch: 0\n",
    )
    assert config.main(["check", cell]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert any(line.startswith("typo.yaml: bus.conect: no such key") for line in lines)
    assert any(line.startswith("typo.yaml: seed: ") for line in lines)
    assert any(line.startswith("typo.yaml: learner.batch: ") for line in lines)


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("control.synchronous=true", "control.synchronous: only for lock-step"),
        ("planner.horizon=2", "planner.horizon (2) must exceed control.steps_per_plan (2)"),
        ("planner.members=6", "planner.members (6) exceed model.members (5)"),
        ("model.hidden=[8, 8]", "learner.loss.decay: 3 values wanted"),
        (
            "task=egg",
            "learner.loss.group_weights: no group tips in task egg; it has qpos, qvel, "
            "object_linear_velocity, object_angular_velocity, object_position, object_rotation",
        ),
    ],
)
def test_sections_that_contradict_each_other_are_refused(override: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_cell("reach", [override])
    assert [complaint in line for line in error.value.lines] == [True]


def machines(**services: list[str]) -> str:
    placed = {
        name: {"address": f"127.0.0.{i + 1}", "services": names}
        for i, (name, names) in enumerate(services.items())
    }
    return yaml.safe_dump({"cell": "x", "planner": {"preset": "fast"}, "machines": placed})


@pytest.mark.parametrize(
    ("services", "complaint"),
    [
        ({"a": ["router", "sim", "planner", "learner"]}, "machines: curriculum runs on no machine"),
        (
            {"a": ["router", "sim", "planner", "learner", "curriculum"], "b": ["sim"]},
            "machines: sim runs on 2 machines",
        ),
        (
            {"a": ["router", "sim", "planner", "learner", "curriculum", "lerner"]},
            "machines: lerner is no service",
        ),
    ],
)
def test_services_must_be_known_unique_and_complete(
    tmp_path: Path, services: dict[str, list[str]], complaint: str
) -> None:
    with pytest.raises(ConfigError, match=complaint):
        load_cell(write(tmp_path / "x.yaml", machines(**services)))


def test_the_bus_is_at_the_routers_machine(tmp_path: Path) -> None:
    text = machines(a=["sim", "planner", "learner", "curriculum"], b=["router"])
    cell = load_cell(write(tmp_path / "x.yaml", text))
    assert cell.bus.connect == cell.bus.listen == ("tcp/127.0.0.2:7447",)


def test_each_machine_has_its_own_watchdog_and_dials_from_its_own_address() -> None:
    cell = load_cell("three_machines")
    assert instances_of(cell, "learning") == ("planner", "learner", "watchdog_learning")
    rendered = process_config(cell, "watchdog_learning", "learning")
    assert rendered["watchdog"]["name"] == "watchdog_learning"
    assert rendered["watchdog"]["watches"] == ["planner", "learner"]
    assert rendered["bus"]["bind"] == "127.0.0.2:0"


def test_everything_on_one_machine_stays_on_it() -> None:
    cell = load_cell("three_machines", ["bus.connect=[tcp/10.0.0.5:7000]", "bus.listen=[tcp/10.0.0.5:7000]"])
    local = on_this_machine(cell)
    assert local.bus.connect == local.bus.listen == ("tcp/127.0.0.1:7000",)
    assert instances_of(local, "local") == IN_SIMULATION


def test_the_hash_tells_values_apart_but_not_places() -> None:
    cell = load_cell("reach")
    assert load_cell("reach", ["run_dir=/tmp/elsewhere"]).config_hash == cell.config_hash
    assert load_cell("reach", ["seed=1"]).config_hash != cell.config_hash


def test_unknown_cell_names_those_that_exist() -> None:
    with pytest.raises(ConfigError, match=r"no such cell.*debug"):
        find_cell("raech")


def test_effective_cell_is_saved_and_loads_to_the_same_hash(tmp_path: Path) -> None:
    cell = load_cell("debug", [f"run_dir={tmp_path}/run"])
    files = write_process_configs(cell)
    assert {path.stem for path in files.config_dir.glob("*.yaml")} == {"cell", *IN_SIMULATION}
    assert load_cell(str(files.config_of("cell"))).config_hash == cell.config_hash


def test_a_run_directory_is_not_continued_with_another_seed(tmp_path: Path) -> None:
    write_process_configs(load_cell("debug", [f"run_dir={tmp_path}/run"]))
    write_process_configs(load_cell("debug", [f"run_dir={tmp_path}/run", "curriculum.episodes=9"]))
    with pytest.raises(ConfigError, match="another seed"):
        write_process_configs(load_cell("debug", [f"run_dir={tmp_path}/run", "seed=4"]))


def test_a_path_too_long_for_a_socket_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="characters"):
        write_process_configs(load_cell("debug", [f"run_dir={tmp_path}/{'x' * 100}"]))


def test_process_of_knows_instances() -> None:
    assert process_of("watchdog_learning").name == "watchdog"


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        (["can.interface=socketcan", "can.channel=can0"], "an emulated hand has no place on socketcan"),
        (
            ["plant=hand", "can.interface=pcan", "can.channel=PCAN_USBBUS1", "pose_source=perception"],
            "auto_arm: a hand that can hurt",
        ),
        (["plant=hand"], "pose_source: only an emulated hand has a twin"),
        (["task=reach"], "task: reach is none for the DexHand 021"),
        (["can.interface=virtual"], "virtual is a bus within one process"),
        (["can.interface=kvaser", "can.channel=first"], "channel of kvaser must be a number"),
    ],
)
def test_a_hand_that_cannot_be_driven_so_is_refused(overrides: list[str], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        load_cell("dexhand_twin", overrides)


def test_frames_without_a_limit_of_current_must_be_accepted_for_a_real_hand() -> None:
    short = ["hand.motion=board_short"]
    assert load_cell("dexhand_twin", short).hand.motion == "board_short"
    real = [*short, "plant=hand", "pose_source=perception", "hand_io.auto_arm=false", "can.interface=pcan"]
    real.append("can.channel=PCAN_USBBUS1")
    with pytest.raises(ConfigError, match="board_short carries no limit of current"):
        load_cell("dexhand_twin", real)
    cell = load_cell("dexhand_twin", [*real, "hand.accept_no_current_limit=true"])
    process = process_config(cell, "hand_io")
    parse(HandIoProcess, process, "hand_io")
    process["hand"]["accept_no_current_limit"] = False  # the process trusts nobody either
    with pytest.raises(ConfigError, match="board_short carries no limit of current"):
        parse(HandIoProcess, process, "hand_io")


def test_each_plant_brings_its_own_processes() -> None:
    twin = load_cell("dexhand_twin")
    names = instances_of(twin, "local")
    assert "sim" not in names and {"emulator", "hand_io"} < set(names)
    assert names.index("emulator") < names.index("hand_io") < names.index("curriculum")
    real = load_cell(
        "dexhand_twin",
        [
            "plant=hand",
            "can.interface=pcan",
            "can.channel=PCAN_USBBUS1",
            "pose_source=perception",
            "hand_io.auto_arm=false",
        ],
    )
    assert "emulator" not in instances_of(real, "local")
    assert "camera" not in instances_of(real, "local") and "perception" in instances_of(real, "local")
    assert not {"camera", "perception"} & set(names)
    watched = load_cell("dexhand_camera")
    assert {"camera", "perception", "emulator", "hand_io"} < set(instances_of(watched, "local"))
    assert "hand_io" not in process_config(twin, "watchdog")["watchdog"]["watches"]  # people arm it

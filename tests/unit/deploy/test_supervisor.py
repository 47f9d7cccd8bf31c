import shlex
import sys
from configparser import RawConfigParser
from pathlib import Path

import pytest
from supervisor.options import ServerOptions

from common.config import ConfigError
from deploy.processes import NAMES
from deploy.supervisor import RunFiles, check_paths, render
from deploy.supervisor_client import ProcessInfo, SupervisorClient, SupervisorError


def parsed(files: RunFiles) -> RawConfigParser:
    parser = RawConfigParser()
    parser.read_string(render(files, NAMES))
    return parser


def test_each_process_has_a_program(tmp_path: Path) -> None:
    conf = parsed(RunFiles(tmp_path))
    assert [name for name in conf.sections() if name.startswith("program:")] == [
        f"program:{n}" for n in NAMES
    ]
    planner = conf["program:planner"]
    assert (
        planner["command"] == f"{sys.executable} -m services.planner --config {tmp_path}/config/planner.yaml"
    )
    assert planner["stdout_logfile"] == f"{tmp_path}/logs/planner.log"
    assert (planner["stopwaitsecs"], planner["autorestart"]) == ("10", "true")
    assert 'OMP_NUM_THREADS="1"' in planner["environment"]
    assert conf["program:curriculum"]["autorestart"] == "unexpected"


def test_start_order_is_that_of_the_table(tmp_path: Path) -> None:
    conf = parsed(RunFiles(tmp_path))
    priorities = [int(conf[f"program:{name}"]["priority"]) for name in NAMES]
    assert priorities == sorted(set(priorities))


def test_supervisord_accepts_the_file_also_with_spaces_in_its_path(tmp_path: Path) -> None:
    files = RunFiles(tmp_path / "half done", "control")
    for directory in (files.config_dir, files.log_dir):
        directory.mkdir(parents=True)
    files.supervisor_config.write_text(render(files, NAMES), encoding="utf-8")
    options = ServerOptions()
    options.realize(["-c", str(files.supervisor_config)])
    programs = {group.name: group.process_configs[0] for group in options.process_group_configs}
    assert set(programs) == set(NAMES)
    assert programs["sim"].stdout_logfile == str(files.log_of("sim"))
    assert shlex.split(programs["sim"].command)[-1] == str(files.config_of("sim"))
    assert options.configroot.supervisord.server_configs[0]["file"] == str(files.socket)


def test_nobody_answers_without_supervisord(tmp_path: Path) -> None:
    client = SupervisorClient(tmp_path / "none.sock")
    assert not client.running()
    with pytest.raises(SupervisorError, match=r"does not answer at .*none\.sock"):
        client.processes()


@pytest.mark.parametrize(
    ("state", "exit_code", "finished"),
    [
        ("EXITED", 0, True),
        ("EXITED", 1, False),
        ("FATAL", 0, False),
        ("RUNNING", 0, False),
        ("STOPPED", 0, False),
    ],
)
def test_finished_is_an_exit_with_code_0(state: str, exit_code: int, finished: bool) -> None:
    assert ProcessInfo("x", state, 0, exit_code, 5.0, "").finished is finished


def test_paths_that_supervisord_cannot_read_are_refused(tmp_path: Path) -> None:
    check_paths(RunFiles(tmp_path))
    with pytest.raises(ConfigError, match="rename the folder"):
        check_paths(RunFiles(tmp_path / "50% done"))

"""What a failing process means for the others: the end if the cell needs it, a warning if not."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from deploy import launch as launch_module
from deploy.cell import load_cell
from deploy.launch import Launch, LaunchError
from deploy.monitor import Monitor
from deploy.supervisor_client import ProcessInfo


@pytest.fixture
def launch(tmp_path: Path) -> Launch:
    return Launch(load_cell("debug", [f"run_dir={tmp_path}"]))


def infos(launch: Launch, **states: str) -> dict[str, ProcessInfo]:
    return {name: ProcessInfo(name, states.get(name, "RUNNING"), 1, 0, 10.0, "") for name in launch.instances}


@pytest.mark.parametrize("name", ["viewer", "watchdog"])
def test_an_optional_process_that_is_given_up_is_told_of_once(launch: Launch, name: str) -> None:
    said: list[str] = []
    for _ in range(3):
        launch.check(infos(launch, **{name: "FATAL"}), said.append)
    (line,) = said
    assert line.startswith(f"going on without {name} fails again and again; the end of ")


@pytest.mark.parametrize("name", ["router", "sim", "planner", "learner", "curriculum"])
def test_a_required_one_ends_the_run(launch: Launch, name: str) -> None:
    with pytest.raises(LaunchError, match=f"^{name} fails again and again"):
        launch.check(infos(launch, **{name: "FATAL", "viewer": "FATAL"}), lambda _: None)


def wait(launch: Launch, known: dict[str, ProcessInfo], said: list[str]) -> tuple[str, ...]:
    heard = {name: SimpleNamespace(fresh=True, health=SimpleNamespace(state="working")) for name in known}
    del heard["viewer"]
    monitor = cast(Monitor, SimpleNamespace(poll=lambda: heard))
    launch.client = cast(Any, SimpleNamespace(processes=lambda: known))
    return launch.wait_healthy(monitor, said.append, lambda: False, launch.instances)


def test_a_start_does_not_wait_for_an_optional_process_that_is_given_up(launch: Launch) -> None:
    said: list[str] = []
    assert wait(launch, infos(launch, viewer="FATAL"), said) == ("viewer",)
    assert [line for line in said if line.startswith("going on without ")] == said[-1:]


def test_nor_for_one_that_is_silent_beyond_its_deadline(
    launch: Launch, monkeypatch: pytest.MonkeyPatch
) -> None:
    passing = iter(range(0, 1000, 50))
    clock = SimpleNamespace(monotonic=lambda: float(next(passing)), sleep=lambda _: None)
    monkeypatch.setattr(launch_module, "time", clock)
    said: list[str] = []
    assert wait(launch, infos(launch), said) == ("viewer",)
    assert said[-1].startswith("going on without viewer is not healthy after 100 s; ")

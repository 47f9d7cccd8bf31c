from importlib.util import find_spec

import pytest

from deploy.cell import Cell
from deploy.processes import NAMES, PROCESSES, Process


@pytest.mark.parametrize("process", PROCESSES, ids=NAMES)
def test_each_row_is_complete(process: Process) -> None:
    assert find_spec(process.module) is not None
    assert all(section in Cell.model_fields for section in process.sections)
    assert all(NAMES.index(needed) < NAMES.index(process.name) for needed in process.needs)
    assert process.warm_up_s < process.start_deadline_s
    assert process.warm_up_s > 0 or process.autorestart == "on_error"


def test_names_are_unique() -> None:
    assert len(set(NAMES)) == len(NAMES)


def test_the_router_starts_first_and_stops_last() -> None:
    assert NAMES[0] == "router"
    waves = [process.stop_wave for process in PROCESSES if process.name != "router"]
    assert PROCESSES[0].stop_wave > max(waves)


def test_only_the_curriculum_may_finish() -> None:
    assert [process.name for process in PROCESSES if process.autorestart == "on_error"] == ["curriculum"]

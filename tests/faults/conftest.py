"""One live cell for all tests that can share it."""

import pytest

from common.messages import Mode
from common.topics import STEP
from tests.faults.cell import LiveCell, free_ports, wait

UNTOUCHED = 2  # training episodes before anything is done to the cell


@pytest.fixture(scope="package")
def shared(tmp_path_factory):
    cell = LiveCell(tmp_path_factory.mktemp("cell"), free_ports(3))
    try:
        cell.up()
        wait(lambda: trained(cell.heard) >= UNTOUCHED, "the first training episodes")
        yield cell
    finally:
        cell.end()


@pytest.fixture
def cell(shared):
    """The shared cell, at work."""
    if not shared.supervisor.running():
        shared.up()
    return shared


def trained(ear):
    """How many training episodes have been seen to end."""
    return sum(s.message.last and s.message.mode is Mode.PLAN for s in ear.samples(STEP))

"""`python -m deploy.doctor [can] [CELL] [--set a.b=c]`: is a running cell (or its hand) in order?

Changes nothing; only `can --status` does, which takes all torque away (deploy/doctor_can.py).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

from common.clock_offset import measure_offset
from common.config import ConfigError
from common.zenoh_bus import ZenohBus
from common.zenoh_router import BusError
from deploy import doctor_can
from deploy.cell import ALL_LOCAL, Cell, instances_of, load_cell, on_this_machine
from deploy.checks import Check, print_checks, read_options
from deploy.monitor import Heard, Monitor
from deploy.processes import process_of

ROUTER_TIMEOUT_S = 3.0
LISTEN_S = 2.5
PINGS = 20
OFFSET_LIMIT_MS = 2.0
ROUND_TRIP_LIMIT_MS = 20.0


def main(argv: list[str] | None = None) -> int:
    """Print one line per check; 1 if any failed."""
    arguments = sys.argv[1:] if argv is None else argv
    if arguments[:1] == ["can"]:
        return doctor_can.main(arguments[1:])
    parser = argparse.ArgumentParser(prog="python -m deploy.doctor", description=__doc__)
    options = read_options(parser, "reach", arguments)
    return print_checks(checks(options.cell, options.overrides))


def checks(cell_name: str, overrides: list[str]) -> Iterator[Check]:
    """Examine configuration, router, processes and clocks; stops where nothing more can be seen."""
    try:
        cell = load_cell(cell_name, overrides)
    except ConfigError as error:
        yield from (Check(False, "config", line, "correct the cell") for line in error.lines)
        return
    yield Check(True, "config", f"{cell_name} {cell.config_hash}")
    try:
        patient = cell.bus.model_copy(update={"connect_timeout_s": ROUTER_TIMEOUT_S})
        bus = ZenohBus(patient, cell.cell, "doctor")
    except BusError as error:
        yield Check(False, "router", str(error))
        return
    yield Check(True, "router", f"reached at {' '.join(cell.bus.connect)}")
    try:
        yield from _process_checks(cell, bus)
    finally:
        bus.close()


def _process_checks(cell: Cell, bus: ZenohBus) -> Iterator[Check]:
    heard = _listen(cell, bus)
    tokens = bus.alive()
    for name in expected_processes(cell):
        yield from process_checks(name, tokens, heard.get(name), accepted_hashes(cell))
    for name in tokens:
        if name not in ("doctor", "operator"):
            yield _clock_check(bus, name)


def _listen(cell: Cell, bus: ZenohBus) -> dict[str, Heard]:
    monitor = Monitor(bus, cell)
    deadline = time.monotonic() + LISTEN_S
    while time.monotonic() < deadline:
        monitor.poll()
        time.sleep(0.1)
    return monitor.poll()


def expected_processes(cell: Cell) -> tuple[str, ...]:
    """Name the processes that should be heard, of all machines."""
    names = [name for machine in cell.machines or (ALL_LOCAL,) for name in instances_of(cell, machine)]
    return tuple(name for name in names if process_of(name).heartbeat)


def accepted_hashes(cell: Cell) -> tuple[str, ...]:
    """Digests of this cell as it stands, and as `run_all.sh` starts it all on one machine."""
    return (cell.config_hash, on_this_machine(cell).config_hash)


def process_checks(
    name: str, tokens: tuple[str, ...], heard: Heard | None, hashes: tuple[str, ...]
) -> Iterator[Check]:
    """Judge one process: does it exist, does it work, is it the same software and configuration?"""
    start = f"deploy/run_all.sh restart {name}, and read its log: deploy/run_all.sh logs {name}"
    if name not in tokens:
        yield Check(False, name, "not on the bus", f"start the cell; if it runs: {start}")
        return
    if heard is None or not heard.fresh:
        age = f"silent for {heard.age_s:.1f} s" if heard else "exists but is not heard"
        yield Check(False, name, age, start)
        return
    quiet = f"; quiet inputs: {' '.join(heard.health.stale_inputs)}" if heard.health.stale_inputs else ""
    yield Check(True, name, f"{heard.health.state}, heard {heard.age_s:.1f} s ago{quiet}")
    own = own_version()
    if heard.health.version != own:
        found = f"{heard.health.version}, this one is {own}"
        yield Check(False, f"{name} version", found, "install the same version on all machines")
    if heard.health.config_hash not in hashes:
        found = f"{heard.health.config_hash or '(none)'}, this cell is {hashes[0]}"
        yield Check(
            False, f"{name} config", found, "use the same cell file and --set everywhere, then down and up"
        )


def own_version() -> str:
    """Return the version of this installation, as processes report theirs."""
    try:
        return version("gc-pmpc")
    except PackageNotFoundError:
        return "uninstalled"


def _clock_check(bus: ZenohBus, name: str) -> Check:
    about = f"{name} clock"
    try:
        measure_offset(bus, name, 1)
        offset = measure_offset(bus, name, PINGS)
    except TimeoutError:
        return Check(False, about, "does not answer", "is it frozen? see its health above")
    offset_ms, round_trip_ms = offset.offset_ns / 1e6, offset.rtt_p50_ns / 1e6
    ok = abs(offset_ms) < OFFSET_LIMIT_MS and round_trip_ms < ROUND_TRIP_LIMIT_MS
    found = (
        f"offset {offset_ms:+.2f} ms (spread {offset.spread_ns / 1e6:.2f}), round trip {round_trip_ms:.2f} ms"
    )
    return Check(ok, about, found, "synchronise the clocks (chrony) and look at the network between")


if __name__ == "__main__":
    sys.exit(main())

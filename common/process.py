"""How every process of a cell begins and ends: arguments, config, signals, bus, runner, exit code."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn, TypeVar

from common.built import Built, codec_for, new_boot_id
from common.buslog import BackgroundLog, BusLog, LogSink, NoLog
from common.cell import SharedConfig
from common.clock import WallClock
from common.clock_offset import ClockServer
from common.config import ConfigError, load
from common.live import LiveRunner
from common.runner import Dispatcher
from common.zenoh_bus import ZenohBus
from common.zenoh_router import BusError

# A thread that holds the interpreter is asked to let go after this long; the default, 5 ms, delays a control
# step by as much whenever a snapshot is being read, and an emulated hand's answer at any time.
SWITCH_S = 0.0005

ProcessT = TypeVar("ProcessT", bound=SharedConfig)


def run_process(
    name: str, model: type[ProcessT], build: Callable[[ProcessT, int], Built], nice: int = 0
) -> None:
    """Run one service until it finishes or TERM arrives; ends the process.

    `build(config, boot_id)` makes the service. `nice` lets the processes of the control loop go first.
    Exit codes: 0 finished or stopped, 2 bad config, 3 no bus.
    """
    os.nice(nice)
    sys.setswitchinterval(SWITCH_S)
    boot_id = new_boot_id()
    try:
        config = load(model, *_arguments(name))
        built = build(config, boot_id)
    except ConfigError as error:
        print(error, file=sys.stderr)
        _exit(2)
    except ValueError as error:  # values that are valid one by one but not together
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)
        _exit(2)
    _exit(_serve(built, config, boot_id))


def _arguments(name: str) -> tuple[Path, list[str]]:
    parser = argparse.ArgumentParser(description=f"GC-PMPC process: {name}")
    parser.add_argument("--config", type=Path, required=True, help="YAML rendered by deploy for this process")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    arguments = parser.parse_args()
    return arguments.config, arguments.overrides


def _serve(built: Built, config: SharedConfig, boot_id: int) -> int:
    stop = _stop_on_signals()
    name = built.service.name  # with several machines there is a watchdog on each, with a name of its own
    try:
        bus = ZenohBus(config.bus, config.cell, name)
    except BusError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 3
    ClockServer(bus, name)
    for key, answer in built.queries.items():
        bus.serve(key, answer)
    dispatcher = Dispatcher(
        built.service, codec_for(config.task), bus, built.ports, _log(name, config, boot_id)
    )
    try:
        return LiveRunner(dispatcher, WallClock(), config.config_hash).run(stop)
    finally:
        bus.close()


def _log(name: str, config: SharedConfig, boot_id: int) -> LogSink:
    if not config.log.enabled:
        return NoLog()
    megabyte = 1_000_000
    log = BusLog(
        config.run_dir / "log",
        name,
        boot_id,
        round(config.log.segment_mb * megabyte),
        round(config.log.keep_mb * megabyte),
    )
    return BackgroundLog(log)


def _stop_on_signals() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: stop.set())
    return stop


def _exit(code: int) -> NoReturn:
    """End now: a worker in the middle of a long computation cannot be joined in time."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)

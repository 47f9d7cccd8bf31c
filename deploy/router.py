"""The router of a cell: `python -m deploy.router [--config CELL.yaml] [--listen ENDPOINT ...]`."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path

from common.bus_config import BusConfig
from common.config import ConfigError, parse, read_yaml
from common.zenoh_router import BusError, Router


def main(arguments: list[str] | None = None) -> int:
    """Route until TERM or INT; return 0, or 2 after one line about what is wrong."""
    options = _parser().parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        config = _bus_config(options.config)
        with Router(tuple(options.listen or config.listen), config.lease_ms) as router:
            print(f"router: listening on {' '.join(router.listen)}", flush=True)
            stop.wait()
    except (BusError, ConfigError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy.router", description="Route a cell's messages.")
    parser.add_argument("--config", type=Path, metavar="CELL.yaml", help="cell whose section bus is used")
    parser.add_argument("--listen", action="append", metavar="ENDPOINT", help="such as tcp/127.0.0.1:7447")
    return parser


def _bus_config(path: Path | None) -> BusConfig:
    """Read the section `bus` of a cell; the other sections are the business of other processes."""
    section = read_yaml(path).get("bus") if path else None
    return parse(BusConfig, section or {}, source=f"{path}: bus")


if __name__ == "__main__":
    sys.exit(main())

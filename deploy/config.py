"""`python -m deploy.config check|show|schema [CELL] [--set a.b=c]`: look at a cell without starting it."""

from __future__ import annotations

import argparse
import json
import sys

import yaml

from common.config import ConfigError
from deploy.cell import Cell, load_cell


def main(argv: list[str] | None = None) -> int:
    """Check a cell, show its effective values or print the JSON Schema; 1 after one line per mistake."""
    options = _parser().parse_args(argv)
    if options.action == "schema":
        print(json.dumps(Cell.model_json_schema(), indent=2))
        return 0
    try:
        cell = load_cell(options.cell, options.overrides)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 1
    if options.action == "show":
        print(yaml.safe_dump(cell.model_dump(mode="json"), sort_keys=False), end="")
    else:
        print(f"{options.cell}: ok, task {cell.task}, config {cell.config_hash}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy.config", description=__doc__)
    parser.add_argument("action", choices=("check", "show", "schema"))
    parser.add_argument("cell", nargs="?", default="reach", help="a file, or a name in deploy/cells")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    return parser


if __name__ == "__main__":
    sys.exit(main())

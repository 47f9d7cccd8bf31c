"""One line of what the doctor finds."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One line of the report."""

    ok: bool
    about: str
    found: str
    advice: str = ""

    def __str__(self) -> str:
        """Lay the line out."""
        advice = "" if self.ok or not self.advice else f" -> {self.advice}"
        return f"{'ok  ' if self.ok else 'FAIL'}  {self.about:24}{self.found}{advice}"


def read_options(
    parser: argparse.ArgumentParser, default_cell: str, argv: list[str] | None
) -> argparse.Namespace:
    """Read `cell` and `overrides` from `argv`, beside what `parser` has of its own."""
    parser.add_argument("cell", nargs="?", default=default_cell, help="a file, or a name in deploy/cells")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    return parser.parse_args(argv)


def print_checks(checks: Iterable[Check]) -> int:
    """Print one line per check; 1 if any failed."""
    failed = False
    for check in checks:
        print(check, flush=True)
        failed |= not check.ok
    return int(failed)

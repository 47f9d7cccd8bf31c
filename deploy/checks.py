"""One line of what the doctor finds."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
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


def print_checks(
    parser: argparse.ArgumentParser,
    default_cell: str,
    checks: Callable[[str, list[str]], Iterable[Check]],
    argv: list[str] | None,
) -> int:
    """Read cell and overrides from `argv`, print one line per check of them; 1 if any failed."""
    parser.add_argument("cell", nargs="?", default=default_cell, help="a file, or a name in deploy/cells")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    options = parser.parse_args(argv)
    failed = False
    for check in checks(options.cell, options.overrides):
        print(check, flush=True)
        failed |= not check.ok
    return int(failed)

"""How well its tests guard the last gate before the wire: `python -m bench.gate [--json]`.

Runs them under branch coverage, then against every small fault that can be put into the gate. Needs a
checkout with its tests and the extra `dev`. Exit code 1 if a branch is not reached or a fault goes unnoticed.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import types
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import coverage

from bench.mutants import Site, Subject
from bench.provenance import provenance
from services.hand_io import limits

NAME = "limits"  # under which the tests know the gate
TESTS = ("test_limits", "test_limits_interference")
PATH = Path(limits.__file__)


@dataclass(frozen=True)
class Reached:
    """Statements and branches of the gate, and which of them the tests do not reach."""

    statements: int
    branches: int
    missing: tuple[str, ...]


class GateTests:
    """The tests of the gate as plain calls, each with every set of its parameters."""

    def __init__(self) -> None:
        """Import the tests. Raises ModuleNotFoundError outside of a checkout."""
        self._modules = [importlib.import_module(f"tests.unit.services.hand_io.{name}") for name in TESTS]
        self._calls = [call for module in self._modules for call in _calls(module)]
        self.count = len(self._calls)

    def fail_on(self, gate: types.ModuleType) -> bool:
        """Whether one of the tests fails on `gate`."""
        patches = [mock.patch.object(module, NAME, gate) for module in self._modules]
        for patch in patches:
            patch.start()
        try:
            return self._any_fails()
        finally:
            for patch in patches:
                patch.stop()

    def _any_fails(self) -> bool:
        for position, call in enumerate(self._calls):
            try:
                call()
            except Exception:
                self._calls.insert(0, self._calls.pop(position))  # it soon kills the next one
                return True
        return False


def _calls(module: types.ModuleType) -> list[Callable[[], None]]:
    calls: list[Callable[[], None]] = []
    for name, test in vars(module).items():
        if name.startswith("test_"):
            marks = [mark for mark in getattr(test, "pytestmark", []) if mark.name == "parametrize"]
            values = marks[0].args[1] if marks else [()]
            several = marks and isinstance(marks[0].args[0], tuple)
            calls += [lambda test=test, v=(v if several or not marks else (v,)): test(*v) for v in values]
    return calls


def reached(tests: GateTests) -> Reached:
    """What the tests reach of the gate. Raises RuntimeError if they fail on the gate as it is."""
    measured = coverage.Coverage(branch=True, include=[str(PATH)], data_file=None, config_file=False)
    with measured.collect():
        fails = tests.fail_on(Subject(PATH).original())
    if fails:
        raise RuntimeError("the tests of the gate fail on the gate as it is: run pytest first")
    _, statements, _, missed, _ = measured.analysis2(str(PATH))
    exits = measured.branch_stats(str(PATH))  # by line: all of them, and those taken
    branches = [f"a branch of {line}" for line, (there, taken) in sorted(exits.items()) if taken < there]
    lines = [str(line) for line in missed]
    return Reached(len(statements), sum(there for there, _ in exits.values()), (*lines, *branches))


def survivors(tests: GateTests, subject: Subject, sites: Iterable[Site]) -> list[str]:
    """The faults that no test notices."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # faults divide by zero
        return [site.name for site in sites if not tests.fail_on(subject.mutant(site))]


def main(argv: list[str] | None = None) -> int:
    """Measure, print, and return 0 only if nothing is missing."""
    parser = argparse.ArgumentParser(prog="python -m bench.gate")
    parser.add_argument("--json", action="store_true", help="print JSON")
    as_json = parser.parse_args(argv).json
    tests, subject = GateTests(), Subject(PATH)
    found, alive = reached(tests), survivors(tests, subject, subject.sites)
    result = {
        "tests": tests.count,
        "statements": found.statements,
        "branches": found.branches,
        "not_reached": found.missing,
        "mutants": len(subject.sites),
        "survivors": alive,
        **provenance(),
    }
    if as_json:
        print(json.dumps(result))
    else:
        lines = [f"{found.branches} branches, not reached: {' '.join(found.missing) or 'none'}"]
        lines += [f"{len(subject.sites)} mutants, {len(alive)} survive", *alive]
        print("\n".join(lines))
    return int(bool(found.missing or alive))


if __name__ == "__main__":
    sys.exit(main())

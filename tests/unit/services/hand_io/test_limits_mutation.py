"""A test of the tests: they reach every branch of the gate, and notice faults that are put into it.

`python -m bench.gate` tries every fault; here are some, others at each change of the gate.
"""

from pathlib import Path

import pytest

from bench.gate import PATH, GateTests, reached, survivors
from bench.mutants import Subject

SHARE = 8  # one fault in so many is tried here


@pytest.fixture(scope="module")
def tests():
    return GateTests()


def test_every_branch_of_the_gate_is_reached(tests):
    found = reached(tests)
    assert found.missing == ()
    assert (found.statements > 100, found.branches >= 4) == (True, True)


def test_a_branch_that_is_not_reached_is_named(tests, monkeypatch):
    monkeypatch.setattr(tests, "_calls", tests._calls[:2])
    assert reached(tests).missing != ()


def test_the_gate_itself_survives_when_loaded_as_a_mutant_is(tests):
    assert not tests.fail_on(Subject(PATH).original())


def test_faults_in_the_gate_are_noticed(tests):
    subject = Subject(PATH)
    assert len(subject.sites) > 100
    assert survivors(tests, subject, subject.sites[::SHARE]) == []


def faults(tmp_path: Path, source: str):
    path = tmp_path / "subject.py"
    path.write_text(source)
    subject = Subject(path)
    return {site.name.partition(": ")[2]: subject.mutant(site) for site in subject.sites}


def test_each_fault_changes_one_thing(tmp_path):
    found = faults(tmp_path, "def f(x: int) -> int:\n    return x + 2 if x < 3 else -x\n")
    results = {name: [mutant.f(x) for x in (2, 3, 4)] for name, mutant in found.items()}
    assert results == {
        "x + 2: operator": [0, -3, -4],
        "2: constant": [5, -3, -4],
        "x < 3: LtE": [4, 5, -4],
        "x < 3: Gt": [-2, -3, 6],
        "3: constant": [4, 5, -4],
        "-x: sign or negation": [4, 3, 4],
    }


def test_a_fault_that_nothing_notices_survives(tmp_path, tests):
    path = tmp_path / "subject.py"
    path.write_text(PATH.read_text().replace("NS_PER_S = 1e9", "NS_PER_S, UNUSED = 1e9, 77"))
    subject = Subject(path)
    unused = [site for site in subject.sites if site.name.endswith(": 77: constant")]
    assert len(unused) == 1
    assert survivors(tests, subject, unused) == [unused[0].name]

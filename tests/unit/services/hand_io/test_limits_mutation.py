"""A test of the tests: every small fault put into the gate must make one of its tests fail.

Each mutant changes one thing: a comparison, a constant, an operator, a negation, a clip, a choice, a
memory, a count.
It replaces the module that the tests of the gate look at, and these run in this process.
"""

from __future__ import annotations

import ast
import copy
import inspect
import itertools
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from services.hand_io import limits
from tests.unit.services.hand_io import test_limits, test_limits_interference

Edit = Callable[[Any], ast.AST | None]

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
# Calls that bound something: the bound, or the choice, is taken away.
BOUNDING = {"clip", "minimum", "maximum", "min", "max", "round"}


def _edits(node: ast.AST) -> Iterator[tuple[str, Edit]]:
    """Every fault that can be put into this one node."""
    if isinstance(node, ast.Compare):
        for other in COMPARISONS[type(node.ops[0])]:
            yield other.__name__, lambda found, other=other: _with(found, ops=[other()])
    elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS:
        yield "operator", lambda found: _with(found, op=OPERATORS[type(found.op)]())
    elif isinstance(node, ast.BoolOp):
        flipped = ast.And if isinstance(node.op, ast.Or) else ast.Or
        yield "and/or", lambda found: _with(found, op=flipped())
    elif isinstance(node, ast.UnaryOp):
        yield "sign or negation", lambda found: found.operand
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield "constant", lambda found: _with(found, value=found.value + 1)
    elif isinstance(node, ast.Call):
        yield from _call_edits(node)
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute):
        yield "forgotten", lambda _: ast.Pass()
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "statement", lambda _: ast.Pass()


def _call_edits(node: ast.Call) -> Iterator[tuple[str, Edit]]:
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    if name in BOUNDING and node.args:
        for index in range(len(node.args) if name in ("min", "max", "minimum", "maximum") else 1):
            yield f"{name} removed", lambda found, index=index: found.args[index]
    if name == "clip" and len(node.args) == 3:
        for end, function in ((1, "maximum"), (2, "minimum")):
            yield "one-sided clip", lambda found, end=end, name=function: _one_sided(found, end, name)
    if name == "where":
        yield "choice swapped", lambda found: _with(found, args=[found.args[0], found.args[2], found.args[1]])
        for index in (1, 2):
            yield "choice fixed", lambda found, index=index: found.args[index]
    if name == "copy" and isinstance(node.func, ast.Attribute):
        yield "copy removed", lambda found: found.func.value


def _one_sided(call: Any, end: int, name: str) -> ast.AST:
    return ast.Call(ast.Attribute(call.func.value, name, ast.Load()), [call.args[0], call.args[end]], [])


def _with(node: ast.AST, **fields: Any) -> ast.AST:
    for name, value in fields.items():
        setattr(node, name, value)
    return node


class _Replace(ast.NodeTransformer):
    """Apply one edit to the node with a given number, counted in the order of `ast.walk`."""

    def __init__(self, target: ast.AST, edit: Edit) -> None:
        self._target, self._edit = target, edit

    def visit(self, node: ast.AST) -> Any:
        return self._edit(node) if node is self._target else super().visit(node)


TESTS = (test_limits, test_limits_interference)
TREE = ast.parse(inspect.getsource(limits))


def _nodes(tree: ast.Module) -> list[ast.AST]:
    """What mutants may touch: the bodies of the functions and the module's own constants; no annotations."""
    annotations = {
        id(inner)
        for node in ast.walk(tree)
        for name in ("annotation", "returns")
        if isinstance(part := getattr(node, name, None), ast.AST)
        for inner in ast.walk(part)
    }
    return [node for node in ast.walk(tree) if id(node) not in annotations]


def _sites() -> Iterator[tuple[str, int, int]]:
    """(name, number of the node, number of its edit) of every mutant."""
    for number, node in enumerate(_nodes(TREE)):
        for choice, (name, _) in enumerate(_edits(node)):
            yield f"{getattr(node, 'lineno', 0)}: {ast.unparse(node)}: {name}", number, choice


SITES = list(_sites())


def _mutant(number: int, choice: int) -> types.ModuleType:
    tree = copy.deepcopy(TREE)
    target = _nodes(tree)[number]
    edit = next(itertools.islice(_edits(target), choice, None))[1]
    changed = ast.fix_missing_locations(_Replace(target, edit).visit(tree))
    return _load(changed, "services.hand_io.limits_mutant")


def _load(tree: ast.Module, name: str) -> types.ModuleType:
    module = types.ModuleType(name)
    sys.modules[name] = module  # dataclasses looks its own module up
    try:
        exec(compile(tree, name, "exec"), module.__dict__)
    finally:
        del sys.modules[name]
    return module


def _calls() -> list[Callable[[], None]]:
    """Every test of the gate with every set of its parameters."""
    calls: list[Callable[[], None]] = []
    for name, test in itertools.chain(*(vars(module).items() for module in TESTS)):
        if name.startswith("test_"):
            marks = [mark for mark in getattr(test, "pytestmark", []) if mark.name == "parametrize"]
            values = marks[0].args[1] if marks else [()]
            several = marks and isinstance(marks[0].args[0], tuple)
            calls += [lambda test=test, v=(v if several or not marks else (v,)): test(*v) for v in values]
    return calls


CALLS = _calls()


def _killed(mutant: types.ModuleType, monkeypatch: pytest.MonkeyPatch) -> bool:
    for module in TESTS:
        monkeypatch.setattr(module, "limits", mutant)
    for position, call in enumerate(CALLS):
        try:
            call()
        except Exception:
            CALLS.insert(0, CALLS.pop(position))  # what has just killed kills the next one soon
            return True
    return False


def test_the_gate_itself_survives_when_loaded_as_a_mutant_is(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not _killed(_load(copy.deepcopy(TREE), "services.hand_io.limits_mutant"), monkeypatch)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_every_mutant_of_the_gate_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(SITES) > 100
    survivors: list[str] = []
    for name, number, choice in SITES:
        if not _killed(_mutant(number, choice), monkeypatch):
            survivors.append(name)
    assert not survivors, "\n".join([f"{len(survivors)} of {len(SITES)} survive:", *survivors])

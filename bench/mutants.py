"""Small faults put into a module one at a time: what its tests must notice (mutation testing).

Each mutant changes one thing: a comparison, a constant, an operator, a negation, a clip, a choice, a memory,
a count. Source of the method: DeMillo, Lipton, Sayward 1978, Computer 11 (4), 34-41.
"""

from __future__ import annotations

import ast
import copy
import itertools
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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


@dataclass(frozen=True)
class Site:
    """One mutant: its name, the number of the node that it changes, and which of that node's faults it is."""

    name: str
    node: int
    choice: int


class Subject:
    """A module's source, its mutants, and the means to load either."""

    def __init__(self, path: Path) -> None:
        """Read a module's file. Raises OSError or SyntaxError."""
        self._path = path
        self._tree = ast.parse(path.read_text(encoding="utf-8"))
        self.sites = tuple(self._sites())

    def _sites(self) -> Iterator[Site]:
        for number, node in enumerate(_nodes(self._tree)):
            for choice, (name, _) in enumerate(_edits(node)):
                yield Site(f"{getattr(node, 'lineno', 0)}: {ast.unparse(node)}: {name}", number, choice)

    def original(self) -> types.ModuleType:
        """The module anew, its code known by its own file's name."""
        return self._load(self._tree, str(self._path))

    def mutant(self, site: Site) -> types.ModuleType:
        """The module with one fault."""
        tree = copy.deepcopy(self._tree)
        target = _nodes(tree)[site.node]
        edit = next(itertools.islice(_edits(target), site.choice, None))[1]
        return self._load(ast.fix_missing_locations(_Replace(target, edit).visit(tree)), "mutant")

    def _load(self, tree: ast.Module, filename: str) -> types.ModuleType:
        name = f"{self._path.stem}_loaded"
        module = types.ModuleType(name)
        sys.modules[name] = module  # dataclasses look their own module up
        try:
            exec(compile(tree, filename, "exec"), module.__dict__)
        finally:
            del sys.modules[name]
        return module


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

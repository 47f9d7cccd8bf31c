"""The tables of the configuration: every section of a cell, the planner's presets, the shipped cells."""

from __future__ import annotations

import re
import types
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

from deploy.cell import Cell
from deploy.cell_files import CELLS_DIR
from deploy.markdown import Row, code, table
from services.planner.config import PRESETS, PlannerConfig

_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<", "min_length": "length ≥", "max_length": "length ≤"}


def sections(model: type[BaseModel] = Cell, prefix: str = "") -> dict[str, type[BaseModel]]:
    """Every section of a cell by its dotted name; `cell` stands for the values outside of any."""
    found = {prefix or "cell": model}
    for name, info in model.model_fields.items():
        nested = _section_of(info)
        if nested:
            found |= sections(nested, f"{prefix}.{name}" if prefix else name)
    return found


def _section_of(info: FieldInfo) -> type[BaseModel] | None:
    """The model of a nested section, or of the entries of a map of them."""
    for kind in (info.annotation, *get_args(info.annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def config(model: type[BaseModel]) -> str:
    """One row per value of a section."""
    rows = (_value_row(name, info) for name, info in model.model_fields.items() if _section_of(info) is None)
    return table(("key", "default", "allowed", "meaning"), rows)


def _value_row(name: str, info: FieldInfo) -> Row:
    default = "required" if info.is_required() else code(_yaml(info.get_default(call_default_factory=True)))
    return code(name), default, _allowed(info), info.description or ""


def _yaml(value: Any) -> str:
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json")
    plain = to_jsonable_python(value)
    return str(yaml.safe_dump(plain, default_flow_style=True, width=10_000)).removesuffix("...\n").strip()


def _allowed(info: FieldInfo) -> str:
    bounds = [
        f"{sign} {getattr(rule, name):g}"
        for rule in info.metadata
        for name, sign in _BOUNDS.items()
        if getattr(rule, name, None) is not None
    ]
    return ", ".join([_kind(info.annotation), *bounds])


def _kind(hint: Any) -> str:
    if get_origin(hint) is Annotated:
        return _kind(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return ", ".join(map(str, get_args(hint)))
    if get_origin(hint) in (types.UnionType, Union, dict, tuple):
        parts = dict.fromkeys(_kind(each) for each in get_args(hint) if each is not Ellipsis)
        join = {types.UnionType: " or ", Union: " or ", dict: " → "}.get(get_origin(hint), ", ")
        return f"{'list of ' if get_origin(hint) is tuple else ''}{join.join(parts)}"
    name = str(hint.__name__)
    return {"str": "text", "Path": "path", "bool": "true, false"}.get(name, name)


def presets() -> str:
    """The planner's values that differ between its presets."""
    configs = [PlannerConfig.model_validate({"preset": name}).model_dump(mode="json") for name in PRESETS]
    changed = [key for key in configs[0] if key != "preset" and len({str(each[key]) for each in configs}) > 1]
    return table(
        ("key", *PRESETS), ((code(key), *(code(_yaml(each[key])) for each in configs)) for key in changed)
    )


def cells() -> str:
    """The cells that come with the project: first comment, and every value that is not a default."""
    return table(("cell", "what for", "values"), map(_cell_row, sorted(CELLS_DIR.glob("*.yaml"))))


def _cell_row(path: Path) -> Row:
    text = path.read_text(encoding="utf-8")
    about = " ".join(
        line.removeprefix("#").strip() for line in re.findall(r"\A(?:#.*\n)+", text)[0].splitlines()
    )
    data = {key: value for key, value in yaml.safe_load(text).items() if key not in ("cell", "machines")}
    return code(path.stem), about, ", ".join(code(f"{key}={_yaml(value)}") for key, value in _flat(data))


def _flat(data: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value

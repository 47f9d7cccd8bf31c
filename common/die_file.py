"""A die as a YAML file, for one that is not among common.dice."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field, TypeAdapter

from common.config import Frozen, load
from common.die import DIE, NO_QUARTERS, Die

_Level = Annotated[int, Field(ge=0, le=255)]
_Rgb = tuple[_Level, _Level, _Level]
_Quarter = Annotated[int, Field(ge=0, le=3)]


class _DieFile(Frozen):
    """The fields of `Die`, each within what a die on a table can be."""

    size_m: float = Field(default=DIE.size_m, ge=0.01, le=0.2)
    corner_radius_m: float = Field(default=DIE.corner_radius_m, gt=0.0, le=0.03)
    mass_kg: float = Field(default=DIE.mass_kg, gt=0.0, le=2.0)
    pip_radius_m: float = Field(default=DIE.pip_radius_m, gt=0.0, le=0.02)
    pip_spacing_m: float = Field(default=DIE.pip_spacing_m, gt=0.0, le=0.06)
    body_rgb: _Rgb = DIE.body_rgb
    pip_rgb: _Rgb = DIE.pip_rgb
    right_handed: bool = True
    quarters: tuple[_Quarter, _Quarter, _Quarter, _Quarter, _Quarter, _Quarter] = NO_QUARTERS


def read_die(path: Path) -> Die:
    """Read a die; what is not named is as in common.die. Raises ConfigError listing every mistake."""
    return Die(**load(_DieFile, path).model_dump())


def write_die(path: Path, die: Die) -> None:
    """Write a die for `read_die`."""
    fields = TypeAdapter(Die).dump_python(die, mode="json")
    path.write_text(yaml.safe_dump(fields, sort_keys=False), encoding="utf-8")

"""Cell files: where they are, and what one holds together with the cell that it starts from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from common.config import ConfigError, read_yaml, with_overrides

CELLS_DIR = Path(__file__).parent / "cells"
_SUFFIXES = (".yaml", ".yml")


def find_cell(text: str) -> Path:
    """Return the file that `text` names: a path, or a cell that comes with the project."""
    path = Path(text)
    if path.is_file() or path.suffix in _SUFFIXES:
        return path
    shipped = CELLS_DIR / f"{text}.yaml"
    if not shipped.is_file():
        names = " ".join(sorted(file.stem for file in CELLS_DIR.glob("*.yaml")))
        raise ConfigError([f"{text}: no such cell; give a file, or one of: {names}"])
    return shipped


def read_cell(path: Path, overrides: Iterable[str] = ()) -> dict[str, Any]:
    """Return the values of a cell file over those of its base, then `overrides`. Raises ConfigError."""
    data = with_overrides(_read(path, ()), overrides)
    if "base" in data:
        raise ConfigError(["--set base: a base stands in the cell's file; choose another cell instead"])
    return data


def _read(path: Path, above: tuple[Path, ...]) -> dict[str, Any]:
    """`above`: the files that start from this one, for none may start from itself."""
    data = read_yaml(path)
    if "base" not in data:
        return data
    base = _base_file(path, data.pop("base"))
    chain = (*above, path.resolve())
    if base.resolve() in chain:
        names = " -> ".join(file.name for file in (*chain, base))
        raise ConfigError([f"{path.name}: base: goes round in a circle: {names}"])
    return _merged(_read(base, chain), data)


def _base_file(path: Path, base: object) -> Path:
    """The file that `base` of the cell at `path` means; a path is meant from that cell's folder."""
    if not isinstance(base, str) or not base:
        raise ConfigError([f"{path.name}: base: must name a cell or a file (given: {base!r})"])
    if Path(base).suffix in _SUFFIXES:
        return path.parent / base
    try:
        return find_cell(base)
    except ConfigError as error:
        raise ConfigError([f"{path.name}: base: {error}"]) from None


def _merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Sections are merged key by key; any other value, lists too, is replaced."""
    result = {**under, **over}
    for name in under.keys() & over.keys():
        if isinstance(under[name], dict) and isinstance(over[name], dict):
            result[name] = _merged(cast(dict[str, Any], under[name]), cast(dict[str, Any], over[name]))
    return result

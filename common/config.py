"""One YAML file → frozen pydantic models; every mistake is reported at once, one line each."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

ConfigT = TypeVar("ConfigT", bound=BaseModel)


class Frozen(BaseModel):
    """Base of every configuration section: immutable, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ConfigError(Exception):
    """A configuration that cannot be used; `lines` holds one sentence per mistake."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


def load(model: type[ConfigT], path: Path, overrides: Iterable[str] = ()) -> ConfigT:
    """Read `path`, apply `a.b=c` overrides and validate. Raises ConfigError listing every mistake."""
    return parse(model, with_overrides(read_yaml(path), overrides), source=path.name)


def parse(model: type[ConfigT], data: Mapping[str, Any], source: str) -> ConfigT:
    """Validate `data` against `model`. Raises ConfigError with lines `source: a.b: what is wrong`."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError([_line(source, dict(item)) for item in error.errors()]) from None


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping. Raises ConfigError when the file is absent, unreadable or not a mapping."""
    try:
        data: object = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError([f"{path}: cannot be read ({error.strerror})"]) from None
    except yaml.YAMLError as error:
        raise ConfigError([f"{path.name}: is not YAML: {' '.join(str(error).split())}"]) from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError([f"{path.name}: must hold `key: value` lines, found {type(data).__name__}"])
    return data  # pyright: ignore[reportUnknownVariableType]


def with_overrides(data: Mapping[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    """Return a copy of `data` in which each `a.b=c` (c read as YAML) is set. Raises ConfigError."""
    result: dict[str, Any] = json.loads(json.dumps(data))
    for override in overrides:
        dotted, equals, text = override.partition("=")
        if not equals or not dotted.strip():
            raise ConfigError([f"--set {override}: write it as a.b=value"])
        try:
            value: Any = yaml.safe_load(text)
        except yaml.YAMLError:
            raise ConfigError([f"--set {override}: the value is not YAML"]) from None
        _assign(result, dotted.strip().split("."), value, override)
    return result


def _assign(data: dict[str, Any], names: list[str], value: Any, override: str) -> None:
    for name in names[:-1]:
        child = data.setdefault(name, {})
        if not isinstance(child, dict):
            raise ConfigError([f"--set {override}: {name} holds a value, not a section"])
        data = child  # pyright: ignore[reportUnknownVariableType]
    data[names[-1]] = value


def _line(source: str, item: dict[str, Any]) -> str:
    where = ".".join(str(part) for part in item["loc"]) or "(whole file)"
    if item["type"] == "extra_forbidden":
        return f"{source}: {where}: no such key"
    message = str(item["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    given = "" if item["type"] in ("missing", "value_error") else f" (given: {item['input']!r})"
    return f"{source}: {where}: {message[:1].lower()}{message[1:]}{given}"


def digest(config: BaseModel) -> str:
    """Short hash of the effective values; equal configurations have equal digests on every machine."""
    canonical = json.dumps(config.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(canonical.encode()).hexdigest()[:12]

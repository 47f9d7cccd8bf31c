"""Dataclass ↔ MessagePack. Decoding returns a whole, plausible message or raises Refused; nothing between."""

# msgpack ships no type stubs.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

import msgpack
import numpy as np
from numpy.typing import NDArray

from common.messages import VERSION, ArraySpec, Header, Message, Range, Sample
from common.topics import PORTS, TOPICS, Topic, topic_of

MAX_TEXT = 4096
MAX_ENTRIES = 256
MAX_LENGTH = 4096  # of an array axis whose letter the cell does not fix
_HEADER_BOUNDS = 2**62


class Refused(ValueError):  # noqa: N818  (it names an outcome, as StopIteration does)
    """A payload that is not a message of its topic; the text says what is wrong with it."""


class Codec:
    """Encodes and decodes the messages of one cell.

    `dims` fixes shape letters (S, A, G, V) for the cell's task; letters that it lacks are only checked for
    consistency within a message.
    """

    def __init__(self, dims: Mapping[str, int] | None = None) -> None:
        self._dims = dict(dims or {})

    def encode(self, header: Header, message: Message) -> bytes:
        """Pack a message. Raises Refused when a receiver would refuse it, so that nothing bad leaves."""
        lengths = dict(self._dims)
        body = {
            name: write(getattr(message, name), lengths, name) for name, write, _ in _fields(type(message))
        }
        envelope = {
            "v": VERSION,
            "type": type(message).__name__,
            "boot_id": header.boot_id,
            "seq": header.seq,
            "t_ns": header.t_ns,
            "valid": header.valid,
            "body": body,
        }
        _header(envelope)
        return _pack(envelope, type(message))

    def decode(self, key: str, payload: bytes) -> Sample:
        """Unpack what came on `key`. Raises Refused for anything but a valid message of that topic."""
        try:
            topic = topic_of(key)
        except KeyError:
            raise Refused(f"{key}: no such topic") from None
        envelope = _unpack(topic, payload)
        header = _header(envelope)
        body = envelope.get("body")
        if not isinstance(body, dict):
            raise Refused("body: not a map")
        return Sample(key, header, self._message(topic.message, cast(dict[Any, Any], body)))

    def _message(self, kind: type[Message], body: dict[Any, Any]) -> Message:
        fields = _fields(kind)
        unknown = set(body) - {name for name, _, _ in fields}
        if unknown:
            raise Refused(f"{str(sorted(map(str, unknown))[0])[:40]}: no such field")
        lengths = dict(self._dims)
        values: dict[str, Any] = {}
        for name, _, read in fields:
            if name not in body:
                raise Refused(f"{name}: missing")
            values[name] = read(body[name], lengths, name)
        return kind(**values)


def _pack(envelope: dict[str, Any], kind: type[Message]) -> bytes:
    try:
        payload = cast(bytes, msgpack.packb(envelope, use_bin_type=True))
    except (ValueError, OverflowError) as error:
        raise Refused(f"cannot be packed: {error}") from None
    limit = next(topic.max_bytes for topic in (*TOPICS, *PORTS) if topic.message is kind)
    if len(payload) > limit:
        raise Refused(f"{len(payload)} bytes, at most {limit}")
    return payload


def _unpack(topic: Topic, payload: bytes) -> dict[Any, Any]:
    if len(payload) > topic.max_bytes:
        raise Refused(f"{len(payload)} bytes, at most {topic.max_bytes}")
    try:
        envelope: object = msgpack.unpackb(payload, raw=False, strict_map_key=True)
    except (ValueError, msgpack.UnpackException, RecursionError):
        raise Refused("not MessagePack") from None
    if not isinstance(envelope, dict):
        raise Refused("not a map")
    found = cast(dict[Any, Any], envelope)
    version, kind = found.get("v"), found.get("type")
    if type(version) is not int or version != VERSION:
        raise Refused(f"version {_brief(version)}, expected {VERSION}")
    if kind != topic.message.__name__:
        raise Refused(f"type {_brief(kind)}, expected {topic.message.__name__}")
    if set(found) != {"v", "type", "boot_id", "seq", "t_ns", "valid", "body"}:
        raise Refused("envelope: unexpected fields")
    return found


def _brief(value: object) -> str:
    """Show a value of any kind; containers by kind only, for they may be nested too deep to be printed."""
    return str(value)[:40] if isinstance(value, str | int | float | None) else type(value).__name__


def _header(envelope: dict[Any, Any]) -> Header:
    numbers: list[int] = []
    for name, low in (("boot_id", 1), ("seq", 0), ("t_ns", 0)):
        value = envelope.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= _HEADER_BOUNDS:
            raise Refused(f"{name}: not an integer from {low} to 2^62")
        numbers.append(value)
    if not isinstance(envelope["valid"], bool):
        raise Refused("valid: not a boolean")
    return Header(numbers[0], numbers[1], numbers[2], envelope["valid"])


_Write = Callable[[Any, dict[str, int], str], Any]
_Read = Callable[[Any, dict[str, int], str], Any]


@cache
def _fields(kind: type[Message]) -> tuple[tuple[str, _Write, _Read], ...]:
    """Per field of a message class: name, writer, reader, built once from its annotations."""
    hints = get_type_hints(kind, include_extras=True)
    rows: list[tuple[str, _Write, _Read]] = []
    for item in dataclasses.fields(kind):
        write, read = _converters(hints[item.name])
        rows.append((item.name, write, read))
    return tuple(rows)


def _converters(hint: Any) -> tuple[_Write, _Read]:
    rule: object = None
    if get_origin(hint) is Annotated:
        hint, rule = get_args(hint)[:2]
    if isinstance(rule, ArraySpec):
        spec = rule
        return (
            lambda value, lengths, name: _write_array(value, spec, lengths, name),
            lambda value, lengths, name: _read_array(value, spec, lengths, name),
        )
    read = _reader(hint, rule if isinstance(rule, Range) else None)
    # Writing runs the reader too: a sender cannot emit what a receiver would refuse.
    return lambda value, lengths, name: _plain(read(_plain(value), lengths, name)), read


def _plain(value: Any) -> Any:
    if isinstance(value, StrEnum):
        return value.value
    if isinstance(value, tuple):
        return list(cast(tuple[Any, ...], value))
    return value


def _reader(hint: Any, bounds: Range | None) -> _Read:
    plain: dict[Any, _Read] = {bool: _read_bool, str: _read_text, bytes: _read_bytes}
    if hint in plain:
        return plain[hint]
    if hint is int:
        return lambda value, _, name: _read_int(value, bounds, name)
    if hint is float:
        return lambda value, _, name: _read_float(value, bounds, name)
    return _container_reader(hint)


def _container_reader(hint: Any) -> _Read:
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return lambda value, _, name: _read_enum(value, hint, name)
    if get_origin(hint) is dict:
        inner = _reader(get_args(hint)[1], None)
        return lambda value, lengths, name: _read_map(value, inner, lengths, name)
    if get_origin(hint) is tuple:
        return _read_texts
    raise TypeError(f"no wire form for {hint}")


def _read_bool(value: Any, _: dict[str, int], name: str) -> bool:
    if not isinstance(value, bool):
        raise Refused(f"{name}: not a boolean")
    return value


def _read_int(value: Any, bounds: Range | None, name: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise Refused(f"{name}: not an integer")
    _check_range(value, bounds, name)
    return value


def _read_float(value: Any, bounds: Range | None, name: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise Refused(f"{name}: not a finite number")
    _check_range(value, bounds, name)
    return float(value)


def _check_range(value: float, bounds: Range | None, name: str) -> None:
    if bounds is not None and not bounds.low <= value <= bounds.high:
        raise Refused(f"{name}: outside {bounds.low} to {bounds.high} {bounds.unit}".rstrip())


def _read_text(value: Any, _: dict[str, int], name: str) -> str:
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise Refused(f"{name}: not a text of at most {MAX_TEXT} characters")
    return value


def _read_bytes(value: Any, _: dict[str, int], name: str) -> bytes:
    if not isinstance(value, bytes):
        raise Refused(f"{name}: not bytes")
    return value


def _read_enum(value: Any, kind: type[StrEnum], name: str) -> StrEnum:
    try:
        return kind(value)
    except ValueError:
        raise Refused(f"{name}: not one of {', '.join(kind)}") from None


def _read_map(value: Any, inner: _Read, lengths: dict[str, int], name: str) -> dict[str, Any]:
    if not isinstance(value, dict) or len(cast(dict[Any, Any], value)) > MAX_ENTRIES:
        raise Refused(f"{name}: not a map of at most {MAX_ENTRIES} entries")
    entries = cast(dict[Any, Any], value)
    return {_read_text(key, lengths, name): inner(entry, lengths, name) for key, entry in entries.items()}


def _read_texts(value: Any, lengths: dict[str, int], name: str) -> tuple[str, ...]:
    if not isinstance(value, list) or len(cast(list[Any], value)) > MAX_ENTRIES:
        raise Refused(f"{name}: not a list of at most {MAX_ENTRIES} texts")
    return tuple(_read_text(entry, lengths, name) for entry in cast(list[Any], value))


def _write_array(value: Any, spec: ArraySpec, lengths: dict[str, int], name: str) -> list[Any]:
    try:
        array = np.asarray(value).astype(spec.dtype, order="C", casting="same_kind")
    except (TypeError, ValueError):
        raise Refused(f"{name}: not an array of {spec.dtype}") from None
    _check_shape(array.shape, spec, lengths, name)
    _check_values(array, spec, name)
    return [spec.dtype, list(array.shape), array.tobytes()]


def _read_array(value: Any, spec: ArraySpec, lengths: dict[str, int], name: str) -> NDArray[Any]:
    if not isinstance(value, list) or len(cast(list[Any], value)) != 3:
        raise Refused(f"{name}: not an array")
    dtype, shape, raw = cast(list[Any], value)
    if dtype != spec.dtype:
        raise Refused(f"{name}: dtype {_brief(dtype)}, expected {spec.dtype}")
    if not isinstance(shape, list) or not all(type(n) is int and n >= 0 for n in cast(list[Any], shape)):
        raise Refused(f"{name}: shape is not a list of lengths")
    sizes = tuple(cast(list[int], shape))
    _check_shape(sizes, spec, lengths, name)
    if not isinstance(raw, bytes) or len(raw) != math.prod(sizes) * np.dtype(spec.dtype).itemsize:
        raise Refused(f"{name}: wrong number of bytes")
    array = np.frombuffer(raw, dtype=spec.dtype).reshape(sizes)
    _check_values(array, spec, name)
    return array


def _check_shape(shape: tuple[int, ...], spec: ArraySpec, lengths: dict[str, int], name: str) -> None:
    if len(shape) != len(spec.shape):
        raise Refused(f"{name}: {len(shape)} axes, expected {len(spec.shape)}")
    for size, axis in zip(shape, spec.shape, strict=True):
        expected = axis if isinstance(axis, int) else lengths.setdefault(axis, size)
        if size != expected or size > MAX_LENGTH:
            raise Refused(f"{name}: {axis} is {size}, expected {min(expected, MAX_LENGTH)}")


def _check_values(array: NDArray[Any], spec: ArraySpec, name: str) -> None:
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise Refused(f"{name}: not finite")
    if array.size and np.abs(array).max() > spec.limit:
        raise Refused(f"{name}: beyond {spec.limit:g}")

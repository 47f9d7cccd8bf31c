"""Glove recordings in binary formats, each read by a library of the extra `glove`.

LeRobot parquet (v2.1 and v3.0), HDF5 groups, MCAP with JSON messages or ROS 2's JointState.
"""

from __future__ import annotations

import importlib
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from itertools import groupby
from typing import Any, TypeVar, cast

from common.dexhand021.glove_recording import COLUMNS, TIME_COLUMNS, GloveError, Table
from common.dexhand021.glove_text import table_of_rows

ReadT = TypeVar("ReadT")
JOINT_STATE = "sensor_msgs/msg/JointState"


def library(name: str, source: str) -> Any:
    """A library that not everybody has, for the file `source`. Raises GloveError."""
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise GloveError(f"{source}: needs {package}: .venv/bin/pip install -e '.[glove]'") from None


def _guarded(read: Callable[[], ReadT], source: str, kind: str) -> ReadT:
    """Run a library's reader, whose errors come in any class for a file that is broken."""
    try:
        return read()
    except GloveError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:120]
        raise GloveError(f"{source}: cannot be read as {kind} ({text})") from None


def read_parquet(data: bytes, source: str, info: Mapping[str, Any] | None = None) -> list[Table]:
    """The episodes of a LeRobot data file; `info` is the data set's meta/info.json. Raises GloveError.

    Features that are vectors are taken apart by the names that `info` has for them.
    """
    parquet = library("pyarrow.parquet", source)
    arrow: Any = _guarded(lambda: parquet.read_table(io.BytesIO(data)), source, "parquet")
    stated: dict[bytes, bytes] = arrow.schema.metadata or {}
    declared = stated.get(b"unit", b"").decode(errors="replace")
    cells: dict[str, Sequence[Any]] = _guarded(arrow.to_pydict, source, "parquet")
    columns = _taken_apart(cells, info or {}, source)
    rate_hz = (info or {}).get("fps")
    rate_hz = float(rate_hz) if isinstance(rate_hz, int | float) and rate_hz > 0 else None
    if "episode_index" not in columns:
        return [Table(source, columns, declared, rate_hz)]
    tables: list[Table] = []
    for episode, rows in groupby(range(arrow.num_rows), lambda row: columns["episode_index"][row]):
        chosen = list(rows)
        part = {name: [column[row] for row in chosen] for name, column in columns.items()}
        tables.append(Table(f"{source}, episode {episode}", part, declared, rate_hz))
    return tables


def _taken_apart(
    cells: Mapping[str, Sequence[Any]], info: Mapping[str, Any], source: str
) -> dict[str, Sequence[Any]]:
    columns: dict[str, Sequence[Any]] = {}
    for feature, column in cells.items():
        names = _names_of(info.get("features", {}).get(feature, {}).get("names"))
        if not column or not isinstance(column[0], list):
            columns[feature] = column
            continue
        for row, vector in enumerate(column, start=1):
            if names and (vector is None or len(vector) != len(names)):
                length = 0 if vector is None else len(vector)
                raise GloveError(
                    f"{source}: row {row}, column {feature}: {length} values for {len(names)} names"
                )
        columns |= {name: [vector[i] for vector in column] for i, name in enumerate(names)}
    return columns


def _names_of(names: Any) -> list[str]:
    """Names of a vector's elements: a list, or lists within a map, as older data sets have them."""
    if isinstance(names, dict):
        return [name for each in cast(dict[str, Any], names).values() for name in _names_of(each)]
    return [str(name) for name in cast(list[Any], names)] if isinstance(names, list) else []


def read_hdf5(data: bytes, source: str) -> list[Table]:
    """Each group with datasets (T,), or (T, n) with an attribute `columns`. Raises GloveError."""
    h5py = library("h5py", source)
    return _guarded(lambda: _hdf5_tables(h5py, data, source), source, "HDF5")


def _hdf5_tables(h5py: Any, data: bytes, source: str) -> list[Table]:
    with h5py.File(io.BytesIO(data), "r") as file:
        names: list[str] = ["/"]
        file.visit(names.append)
        groups = [file[name] for name in names if isinstance(file[name], h5py.Group)]
        found = [(str(group.name), _hdf5_columns(h5py, group)) for group in groups]
    tables = [
        Table(source if name == "/" else f"{source}, {name}", columns, unit)
        for name, (columns, unit) in found
        if columns
    ]
    if not tables:
        raise GloveError(f"{source}: no group holds columns")
    return tables


def _hdf5_columns(h5py: Any, group: Any) -> tuple[dict[str, Sequence[Any]], str]:
    columns: dict[str, Sequence[Any]] = {}
    unit = _text(group.attrs.get("unit", ""))
    for name, item in group.items():
        if not isinstance(item, h5py.Dataset):
            continue
        if item.ndim == 1:
            columns[name] = item[()].tolist()
        elif item.ndim == 2 and "columns" in item.attrs:
            unit = _text(item.attrs.get("unit", unit))
            columns |= dict(zip(map(_text, item.attrs["columns"]), item[()].T.tolist(), strict=True))
    return columns, unit


def _text(value: object) -> str:
    """An attribute as text: HDF5 stores strings of fixed length as bytes."""
    return value.decode() if isinstance(value, bytes) else str(value)


def read_mcap(
    data: bytes, source: str, topic: str = "", names: Mapping[str, str] | None = None
) -> list[Table]:
    """The messages of one topic: JSON objects, or JointState, whose angles are radians. Raises GloveError.

    Without `topic` it must be the only one that has a column of COLUMNS, or what `names` calls it. Time is
    the log time: a time within the messages, whose unit is anybody's guess, counts only if `names` says so.
    """
    reader = library("mcap.reader", source)
    kept = set((names or {}).values())
    rows = _guarded(
        lambda: _mcap_rows(reader.make_reader(io.BytesIO(data)), topic, source, TIME_COLUMNS.keys() - kept),
        source,
        "MCAP",
    )
    wanted = {(names or {}).get(name, name) for name in COLUMNS}
    worn = {each: found for each, found in rows.items() if wanted & found[0].keys()}
    if len(worn) != 1:
        many = f"{' and '.join(sorted(worn))} have columns of a glove: choose one (glove.topic)"
        has = ", ".join(sorted(rows)) or "no message of a known kind"
        none = f"no topic{f' {topic}' if topic else ''} with columns of a glove; there is {has}"
        raise GloveError(f"{source}: {many if worn else none}")
    return [table_of_rows(next(iter(worn.values())), source)]


def _mcap_rows(reader: Any, topic: str, source: str, left_out: Set[str]) -> dict[str, list[dict[str, Any]]]:
    rows: dict[str, list[dict[str, Any]]] = {}
    for name, t_ns, row in _mcap_messages(reader, topic, source):
        told = {each: value for each, value in row.items() if each not in left_out}
        rows.setdefault(name, []).append({"t_ns": t_ns, **told})
    return rows


def _mcap_messages(reader: Any, topic: str, source: str) -> Iterator[tuple[str, int, dict[str, Any]]]:
    decoders: dict[int, Any] = {}
    for schema, channel, message in reader.iter_messages(topics=[topic] if topic else None):
        if channel.message_encoding == "json":
            row: object = json.loads(message.data)
            if isinstance(row, dict):
                yield channel.topic, message.log_time, cast(dict[str, Any], row)
        elif schema is not None and schema.name == JOINT_STATE:
            if schema.id not in decoders:
                factory = library("mcap_ros2.decoder", source).DecoderFactory()
                decoders[schema.id] = factory.decoder_for(channel.message_encoding, schema)
            state = decoders[schema.id](message.data)
            row = dict(zip(state.name, state.position, strict=False))
            yield channel.topic, message.log_time, {**row, "unit": "rad"}

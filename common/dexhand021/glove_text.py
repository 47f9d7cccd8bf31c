"""Glove recordings as text: CSV with a header line, and JSONL with one object a row."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from typing import Any, cast

from common.dexhand021.glove_recording import GloveError, Table


def read_csv(data: bytes, source: str) -> list[Table]:
    """The recording of a CSV file. Raises GloveError."""
    try:
        rows = [row for row in csv.reader(io.StringIO(_text(data, source), newline="")) if row]
    except csv.Error as error:
        raise GloveError(f"{source}: cannot be read as CSV ({error})") from None
    if not rows:
        raise GloveError(f"{source}: is empty")
    head = [name.strip() for name in rows[0]]
    twice = [name for name, times in Counter(head).items() if name and times > 1]
    if twice:
        raise GloveError(f"{source}: column {twice[0]} stands more than once in the header")
    for number, row in enumerate(rows[1:], start=1):
        if len(row) < len(head):
            raise GloveError(f"{source}: row {number}, column {head[len(row)]}: the line ends before it")
        if len(row) > len(head):  # as with a decimal comma
            raise GloveError(f"{source}: row {number} has {len(row)} cells for {len(head)} columns")
    return [Table(source, {name: [row[i] for row in rows[1:]] for i, name in enumerate(head)})]


def read_jsonl(data: bytes, source: str) -> list[Table]:
    """The recording of a JSONL file; a first row may declare the `unit`. Raises GloveError."""
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(filter(str.strip, _text(data, source).splitlines()), start=1):
        try:
            row: object = json.loads(line)
        except json.JSONDecodeError:
            row = None
        if not isinstance(row, dict):
            raise GloveError(f"{source}: row {number} is no JSON object")
        rows.append(cast(dict[str, Any], row))
    return [table_of_rows(rows, source)]


def table_of_rows(rows: list[dict[str, Any]], source: str, unit: str = "") -> Table:
    """Objects to columns; those of the first row count. Raises GloveError for a row that lacks one."""
    if not rows:
        raise GloveError(f"{source}: is empty")
    unit = str(rows[0].get("unit", unit))
    names = [name for name in rows[0] if name != "unit"]
    for number, row in enumerate(rows, start=1):
        lacking = [name for name in names if name not in row]
        if lacking:
            raise GloveError(f"{source}: row {number}, column {lacking[0]}: the row has none")
    return Table(source, {name: [row[name] for row in rows] for name in names}, unit)


def _text(data: bytes, source: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GloveError(f"{source}: is no text in UTF-8") from None

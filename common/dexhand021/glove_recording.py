"""A data glove's recording: twenty joint angles of a person's hand over time, checked cell by cell.

Columns are those of the Manus export, in its order; other gloves are read by renaming columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from common.config import ConfigError

Float64 = NDArray[np.float64]
Unit = Literal["auto", "deg", "rad", "cdeg"]

_FINGERS = ("Index", "Middle", "Ring", "Pinky")
COLUMNS: tuple[str, ...] = (
    *("Thumb_CMC_Spread", "Thumb_CMC_Flex", "Thumb_PIP_Flex", "Thumb_DIP_Flex"),
    *(
        f"{finger}_{joint}"
        for finger in _FINGERS
        for joint in ("MCP_Spread", "MCP_Flex", "PIP_Flex", "DIP_Flex")
    ),
)
# Columns that may tell the time, and ns per unit of each.
TIME_COLUMNS: Mapping[str, float] = {
    "Elapsed_Time_In_Milliseconds": 1e6,
    "time_s": 1e9,
    "timestamp": 1e9,
    "t_ns": 1.0,
}
DEGREES_PER_UNIT: Mapping[str, float] = {"deg": 1.0, "rad": 180.0 / np.pi, "cdeg": 0.01}

MAX_DEG = 180.0  # no joint of a hand bends further
RADIANS_DEG = 3.5  # a hand that moves shows more than this in degrees, and less in radians


class GloveError(ConfigError):
    """A recording that cannot be used; the text is one line that names file, row and column."""

    def __init__(self, text: str) -> None:
        super().__init__([text])


@dataclass(frozen=True)
class Table:
    """What a file holds before anybody has looked at it: cells of any kind; `unit` as declared, or empty."""

    source: str
    columns: Mapping[str, Sequence[object]]
    unit: str = ""
    frame_rate_hz: float | None = None  # with a column frame_index: more exact than LeRobot's float32 stamps


@dataclass(frozen=True, eq=False)
class Recording:
    """Angles (T, 20), degrees, in the order of COLUMNS, at times (T,) that begin with 0."""

    source: str
    t_ns: NDArray[np.int64]
    angles_deg: NDArray[np.float32]


def check(
    table: Table, unit: Unit = "auto", max_gap_s: float = 0.2, names: Mapping[str, str] | None = None
) -> Recording:
    """Turn a table into a recording; `names` says what the file calls a column of ours.

    `auto` is the unit that the file declares, else degrees unless all angles are so small that they must be
    radians. Raises GloveError for the first thing that is wrong.
    """
    called = {name: name for name in (*COLUMNS, *TIME_COLUMNS)} | dict(names or {})
    _demand_columns(table, called)
    _demand_one_length(table, called)
    angles = np.stack([_numbers(table, called[name]) for name in COLUMNS], axis=1)
    t_ns = _times(table, called, max_gap_s)
    degrees = _in_degrees(table, angles, unit, [called[name] for name in COLUMNS])
    return Recording(table.source, t_ns, degrees.astype(np.float32))


def _demand_columns(table: Table, called: Mapping[str, str]) -> None:
    missing = [called[name] for name in COLUMNS if called[name] not in table.columns]
    if missing:
        more = f" (nor {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise GloveError(f"{table.source}: there is no column {missing[0]}{more}")


def _demand_one_length(table: Table, called: Mapping[str, str]) -> None:
    first = called[COLUMNS[0]]
    for name in (called[name] for name in (*COLUMNS, *TIME_COLUMNS)):
        rows, wanted = len(table.columns.get(name, ())), len(table.columns[first])
        if name in table.columns and rows != wanted:
            raise GloveError(f"{table.source}: column {name} has {rows} rows, {first} has {wanted}")


def _numbers(table: Table, name: str) -> Float64:
    """A column as finite numbers (T,)."""
    cells = table.columns[name]
    try:
        values = np.array(cells, np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.array([_number(cell) for cell in cells], np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        row = int(bad[0])
        cell = cells[row]
        found = "the cell is empty" if cell in (None, "") else f"{str(cell)[:20]!r} is not a finite number"
        raise GloveError(f"{_at(table, row, name)}: {found}")
    return values


def _number(cell: object) -> float:
    try:
        return float(cell)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def _at(table: Table, row: int, column: str) -> str:
    """Where a cell is, for people, who count from 1."""
    return f"{table.source}: row {row + 1}, column {column}"


def _times(table: Table, called: Mapping[str, str], max_gap_s: float) -> NDArray[np.int64]:
    name, scale_ns = _time_column(table, called)
    values = _numbers(table, name)
    if len(values) < 2:
        raise GloveError(f"{table.source}: a recording has 2 rows at least, this one {len(values)}")
    with np.errstate(over="ignore", invalid="ignore"):  # nonsense is no step
        t_ns = np.rint((values - values[0]) * scale_ns)
        steps_s = np.diff(t_ns) / 1e9
    wrong = np.flatnonzero(~((steps_s > 0.0) & (steps_s <= max_gap_s)))
    if wrong.size:
        row, step_s = int(wrong[0]) + 1, float(steps_s[wrong[0]])
        where = _at(table, row, name)
        if step_s <= 0.0:
            raise GloveError(f"{where}: time does not advance after row {row}")
        raise GloveError(f"{where}: a gap of {step_s:.3g} s after row {row}, more than {max_gap_s:g} s")
    return t_ns.astype(np.int64)


def _time_column(table: Table, called: Mapping[str, str]) -> tuple[str, float]:
    if table.frame_rate_hz is not None and "frame_index" in table.columns:
        return "frame_index", 1e9 / table.frame_rate_hz
    for name, scale_ns in TIME_COLUMNS.items():
        if called[name] in table.columns:
            return called[name], scale_ns
    raise GloveError(f"{table.source}: there is no column of time ({', '.join(TIME_COLUMNS)})")


def _in_degrees(table: Table, angles: Float64, unit: Unit, names: Sequence[str]) -> Float64:
    known = _unit(table, unit)
    degrees = angles * DEGREES_PER_UNIT[known]
    size = np.abs(degrees)
    row, column = (int(index) for index in np.unravel_index(np.argmax(size), size.shape))
    where, value = _at(table, row, names[column]), f"{angles[row, column]:.6g}"
    if size.max() > MAX_DEG:
        raise GloveError(f"{where}: {value} is no angle in {known}: set the unit (deg, rad or cdeg)")
    if unit == "auto" and not table.unit and size.max() < RADIANS_DEG:
        raise GloveError(f"{where}: the largest angle is {value}, too small for deg: set the unit (rad?)")
    return degrees


def _unit(table: Table, unit: Unit) -> str:
    if table.unit and table.unit not in DEGREES_PER_UNIT:
        raise GloveError(f"{table.source}: its unit {table.unit!r} is none of {', '.join(DEGREES_PER_UNIT)}")
    if table.unit and unit not in ("auto", table.unit):
        raise GloveError(f"{table.source}: says that its unit is {table.unit}, but {unit} is asked for")
    return table.unit or ("deg" if unit == "auto" else unit)

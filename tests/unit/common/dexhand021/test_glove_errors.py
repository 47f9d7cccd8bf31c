"""A recording that cannot be used is refused in one line that names file, row and column."""

import json

import h5py
import numpy as np
import pyarrow
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from common.config import ConfigError
from common.dexhand021.glove_config import GloveConfig, GloveSource
from common.dexhand021.glove_files import read_actions, read_recordings
from common.dexhand021.glove_recording import COLUMNS, GloveError, Table, check
from common.dexhand021.glove_text import read_csv, read_jsonl
from services.sim.glove_writers import write_recordings
from tests.unit.common.dexhand021.glove_samples import AS_IT_IS, column, csv_file, read, recording

MCP = column("Index_MCP_Flex")


def refusal(path, **options):
    with pytest.raises(GloveError) as refused:
        read(path, **options)
    text = str(refused.value)
    assert "\n" not in text
    return text


def spoil(row, col, text):
    def change(cells):
        cells[row][col] = text

    return change


def without(*names):
    def change(cells):
        for name in names:
            index = cells[0].index(name)
            for row in cells:
                del row[index]

    return change


def scaled(factor):
    def change(cells):
        for row in cells[1:]:
            row[2:] = [repr(float(cell) * factor) for cell in row[2:]]

    return change


def cut_out(first, last):
    def change(cells):
        del cells[first : last + 1]

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("Ring_PIP_Flex"), "take.csv: there is no column Ring_PIP_Flex"),
        (
            spoil(0, MCP + 1, " Index_MCP_Flex"),
            "take.csv: column Index_MCP_Flex stands more than once in the header",
        ),
        (
            without("Ring_PIP_Flex", "Pinky_DIP_Flex"),
            "take.csv: there is no column Ring_PIP_Flex (nor 1 more)",
        ),
        (
            without("Elapsed_Time_In_Milliseconds"),
            "take.csv: there is no column of time (Elapsed_Time_In_Milliseconds, time_s, timestamp, t_ns)",
        ),
        (spoil(7, MCP, "nan"), "take.csv: row 7, column Index_MCP_Flex: 'nan' is not a finite number"),
        (spoil(7, MCP, "-inf"), "take.csv: row 7, column Index_MCP_Flex: '-inf' is not a finite number"),
        (spoil(7, MCP, "12,5"), "take.csv: row 7 has 23 cells for 22 columns"),  # a decimal comma
        (
            spoil(7, MCP, "straight"),
            "take.csv: row 7, column Index_MCP_Flex: 'straight' is not a finite number",
        ),
        (spoil(1, MCP, ""), "take.csv: row 1, column Index_MCP_Flex: the cell is empty"),
        (lambda cells: cells[4].pop(), "take.csv: row 4, column Pinky_DIP_Flex: the line ends before it"),
        (
            cut_out(10, 28),
            "take.csv: row 10, column Elapsed_Time_In_Milliseconds: a gap of 0.333 s after row 9, "
            "more than 0.2 s",
        ),
        (
            spoil(5, 1, "1e300"),
            "take.csv: row 5, column Elapsed_Time_In_Milliseconds: a gap of 1e+297 s after row 4, "
            "more than 0.2 s",
        ),
        (
            spoil(5, 1, "50.0"),
            "take.csv: row 5, column Elapsed_Time_In_Milliseconds: time does not advance after row 4",
        ),
        (
            spoil(3, MCP, "4503"),
            "take.csv: row 3, column Index_MCP_Flex: 4503 is no angle in deg: "
            "set the unit (deg, rad or cdeg)",
        ),
        (cut_out(2, 99), "take.csv: a recording has 2 rows at least, this one 1"),
        (cut_out(1, 99), "take.csv: a recording has 2 rows at least, this one 0"),
        (cut_out(0, 99), "take.csv: is empty"),
    ],
)
def test_a_bad_csv_file_is_told_where_it_is_bad(tmp_path, change, message):
    assert refusal(csv_file(tmp_path, change)) == message


def test_radians_are_recognised_and_read_when_they_are_asked_for(tmp_path):
    path = csv_file(tmp_path, scaled(np.pi / 180))
    wanted = recording().angles_deg
    row, col = (int(i) for i in np.unravel_index(np.abs(wanted).argmax(), wanted.shape))
    value = f"{np.radians(float(wanted[row, col])):.6g}"
    assert refusal(path) == (
        f"take.csv: row {row + 1}, column {COLUMNS[col]}: the largest angle is {value}, too small for deg: "
        "set the unit (rad?)"
    )
    (found,) = read(path, unit="rad")
    assert np.abs(found.angles_deg - wanted).max() < 1e-4
    assert np.abs(read(path, unit="deg")[0].angles_deg).max() < 2  # somebody who says so is believed


def test_the_unit_that_a_file_states_must_be_known_and_not_contradicted(tmp_path):
    (path,) = write_recordings(tmp_path, [recording()], "jsonl")
    assert refusal(path, unit="rad") == "take.jsonl: says that its unit is deg, but rad is asked for"
    path.write_text(path.read_text().replace('"deg"', '"gon"'))
    assert refusal(path) == "take.jsonl: its unit 'gon' is none of deg, rad, cdeg"


def test_a_gap_may_be_allowed(tmp_path):
    path = csv_file(tmp_path, cut_out(10, 28))
    assert len(read(path, max_gap_s=0.4)[0].t_ns) == 11


def test_jsonl_rows_must_be_objects_with_all_columns(tmp_path):
    (path,) = write_recordings(tmp_path, [recording()], "jsonl")
    rows = path.read_text().splitlines()
    broken = [*rows[:4], rows[4][:30], *rows[5:]]
    path.write_text("\n".join(broken))
    assert refusal(path) == "take.jsonl: row 5 is no JSON object"
    short = json.loads(rows[4])
    del short["Thumb_DIP_Flex"]
    path.write_text("\n".join([*rows[:4], json.dumps(short), *rows[5:]]))
    assert refusal(path) == "take.jsonl: row 5, column Thumb_DIP_Flex: the row has none"
    short["Thumb_DIP_Flex"] = None
    path.write_text("\n".join([*rows[:4], json.dumps(short), *rows[5:]]))
    assert refusal(path) == "take.jsonl: row 5, column Thumb_DIP_Flex: the cell is empty"


def test_a_bad_cell_in_hdf5_and_parquet_is_told_by_row_and_column(tmp_path):
    bad = recording()
    bad.angles_deg[11, COLUMNS.index("Middle_PIP_Flex")] = np.nan
    (path,) = write_recordings(tmp_path, [bad], "hdf5")
    wanted = "row 12, column Middle_PIP_Flex: 'nan' is not a finite number"
    assert refusal(path) == f"take.h5, /demo_0: {wanted}"
    (path,) = write_recordings(tmp_path / "set", [bad], "lerobot")
    assert refusal(path) == f"episode_000000.parquet, episode 0: {wanted}"


def test_a_lerobot_vector_must_have_a_value_for_each_name(tmp_path):
    (path,) = write_recordings(tmp_path, [recording()], "lerobot")
    (file,) = path.glob("data/*/*.parquet")
    table = parquet.read_table(file)
    rows = table["observation.state"].to_pylist()
    rows[2] = rows[2][:19]
    parquet.write_table(table.set_column(0, "observation.state", pyarrow.array(rows)), file)
    assert refusal(path) == (
        "episode_000000.parquet: row 3, column observation.state: 19 values for 20 names"
    )


@pytest.mark.parametrize(("name", "kind"), [("a.parquet", "parquet"), ("a.h5", "HDF5"), ("a.mcap", "MCAP")])
def test_what_is_no_such_file_is_refused_in_one_line(tmp_path, name, kind):
    (tmp_path / name).write_bytes(b"something else" * 50)
    assert refusal(tmp_path / name).startswith(f"{name}: cannot be read as {kind} (")


def test_files_that_are_not_there_or_of_no_format_are_named(tmp_path):
    absent, other = tmp_path / "a.csv", tmp_path / "a.xlsx"
    other.write_text("")
    assert refusal(absent) == f"{absent}: cannot be read (No such file or directory)"
    assert refusal(other) == (
        f"{other}: no format of a glove; there are .csv, .jsonl, .parquet, .h5, .hdf5, .mcap"
    )
    assert refusal(tmp_path) == f"{tmp_path}: is a folder without data/*/*.parquet, so no LeRobot data set"
    with pytest.raises(GloveError, match="cannot be read"):
        list(read_actions(GloveConfig(sources=(GloveSource(files=(str(tmp_path / "*.csv"),)),)), 3.0))
    with h5py.File(tmp_path / "none.h5", "w"):
        pass
    assert refusal(tmp_path / "none.h5") == "none.h5: no group holds columns"


def test_a_name_that_is_no_column_is_refused():
    with pytest.raises(ValueError, match="Thumb_Flex is no column"):
        GloveConfig(names={"Thumb_Flex": "x"})


@given(st.binary(max_size=300), st.sampled_from([read_csv, read_jsonl]))
def test_any_bytes_are_a_recording_or_one_line(data, reader):
    try:
        for table in reader(data, "bytes"):
            check(table)
    except ConfigError as error:
        assert len(error.lines) == 1 and error.lines[0].startswith("bytes: ") and "\n" not in error.lines[0]


CELL = st.one_of(
    st.floats(), st.text(max_size=3), st.none(), st.integers(), st.just([None]), st.just(10**400)
)
PLACE = st.tuples(st.sampled_from((*COLUMNS, "time_s")), st.integers(0, 3))


@settings(suppress_health_check=[HealthCheck.too_slow])  # the first text of a fresh checkout takes seconds
@given(st.dictionaries(PLACE, CELL, max_size=4))
def test_any_cells_are_a_recording_or_one_line(spoilt):
    columns: dict[str, list[object]] = {name: [40.0, 41.0, 42.0, 43.0] for name in COLUMNS}
    columns["time_s"] = [0.0, 0.1, 0.2, 0.3]
    for (name, row), cell in spoilt.items():
        columns[name][row] = cell
    try:
        found = check(Table("cells", columns))
    except GloveError as error:
        assert str(error).startswith("cells: ") and "\n" not in str(error)
    else:
        assert len(found.t_ns) == len(found.angles_deg) >= 2 and np.isfinite(found.angles_deg).all()


def test_columns_of_different_lengths_are_refused(tmp_path):
    (path,) = write_recordings(tmp_path, [recording()], "hdf5")
    with h5py.File(path, "a") as file:
        del file["demo_0/time_s"]
        file["demo_0/time_s"] = np.arange(29) / 60
    assert refusal(path) == "take.h5, /demo_0: column time_s has 29 rows, Thumb_CMC_Spread has 30"


def test_what_is_read_again_is_the_same(tmp_path):
    (path,) = write_recordings(tmp_path, [recording()], "csv")
    first, second = read_recordings(path, AS_IT_IS)[0], read_recordings(path, AS_IT_IS)[0]
    assert np.array_equal(first.angles_deg, second.angles_deg)

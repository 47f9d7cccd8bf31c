"""Each format gives back exactly what was recorded, and says in one line what it lacks."""

import importlib
import json
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_ros2.writer import Writer as RosWriter
from pyarrow import parquet

from common.dexhand021 import glove_binary
from common.dexhand021.glove_config import GloveConfig, GloveSource, GloveUser
from common.dexhand021.glove_files import read_actions, read_demonstrations
from common.dexhand021.glove_recording import COLUMNS, GloveError, Recording
from services.sim.glove_writers import FORMATS, write_recordings
from tests.unit.common.dexhand021.glove_samples import csv_file, read, recording, same

ANGLE = st.floats(-180, 180, width=32)


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.lists(ANGLE, min_size=20, max_size=20), min_size=2, max_size=5))
def test_every_format_gives_back_every_bit(tmp_path, form, rows):
    angles = np.array(rows, np.float32)
    angles[0, 0] = 45.0  # not all so small that they must be radians
    wanted = Recording("take", np.rint(np.arange(len(rows)) * 1e9 / 60).astype(np.int64), angles)
    (path,) = write_recordings(tmp_path / form, [wanted], form)
    (found,) = read(path)
    assert same(found, wanted)


@pytest.mark.parametrize("form", FORMATS)
def test_several_recordings_come_in_order_and_apart(tmp_path, form):
    wanted = [recording(40 + n, f"take_{n}", seed=n) for n in range(3)]
    paths = write_recordings(tmp_path, wanted, form)
    found = [each for path in paths for each in read(path)]
    assert len(found) == 3 and all(map(same, found, wanted))


def test_a_lerobot_file_may_hold_several_episodes_and_needs_no_meta_for_plain_columns(tmp_path):
    first, second = recording(5), recording(7, seed=1)
    angles = np.concatenate([first.angles_deg, second.angles_deg])
    stamps = np.concatenate([first.t_ns, second.t_ns]) / 1e9
    columns = {name: angles[:, i] for i, name in enumerate(COLUMNS)}
    episodes = {"episode_index": [4] * 5 + [9] * 7, "timestamp": stamps}
    parquet.write_table(pyarrow.table({**columns, **episodes}), tmp_path / "file-000.parquet")
    found = read(tmp_path / "file-000.parquet")
    assert [each.source for each in found] == ["file-000.parquet, episode 4", "file-000.parquet, episode 9"]
    assert all(map(same, found, (first, second)))


def test_hdf5_may_hold_plain_columns_and_many_groups(tmp_path):
    wanted = [recording(6), recording(8, seed=1)]
    with h5py.File(tmp_path / "all.h5", "w") as file:
        for number, each in enumerate(wanted):
            group = file.create_group(f"data/demo_{number}")
            group["t_ns"] = each.t_ns
            for i, name in enumerate(COLUMNS):
                group[name] = each.angles_deg[:, i]
    found = read(tmp_path / "all.h5")
    assert [each.source for each in found] == ["all.h5, /data/demo_0", "all.h5, /data/demo_1"]
    assert all(map(same, found, wanted))


JOINT_STATE = """\
builtin_interfaces/Time stamp
string[] name
float64[] position
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def test_mcap_reads_joint_states_of_ros_2_in_radians(tmp_path):
    wanted = recording(10)
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = RosWriter(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for t_ns, row in zip(wanted.t_ns, wanted.angles_deg, strict=True):
            message = {
                "stamp": {"sec": 0, "nanosec": 0},
                "name": list(COLUMNS),
                "position": np.radians(row.astype(np.float64)).tolist(),
            }
            writer.write_message("/glove", schema, message, log_time=int(t_ns), publish_time=int(t_ns))
        writer.finish()
    (found,) = read(tmp_path / "bag.mcap")
    assert np.array_equal(found.t_ns, wanted.t_ns)
    assert np.abs(found.angles_deg - wanted.angles_deg).max() < 1e-4


def test_hdf5_names_and_units_of_fixed_length_are_read(tmp_path):
    wanted = recording(6)
    with h5py.File(tmp_path / "take.h5", "w") as file:
        file["t_ns"] = wanted.t_ns
        file["angles"] = wanted.angles_deg
        file["angles"].attrs["columns"] = np.array(COLUMNS, "S")
        file["angles"].attrs["unit"] = np.bytes_("deg")
    (found,) = read(tmp_path / "take.h5")
    assert same(found, wanted)


def test_times_within_an_mcap_message_count_only_if_somebody_says_so(tmp_path):
    data = BytesIO()
    writer = Writer(data)
    writer.start()
    schema = writer.register_schema(name="glove", encoding="jsonschema", data=b"{}")
    channel = writer.register_channel(topic="/glove", message_encoding="json", schema_id=schema)
    for n in range(3):
        row = dict.fromkeys(COLUMNS, 40.0) | {"timestamp": 10 * n, "t_ns": 3 * n, "time_s": 0.02 * n}
        t_ns = 5_000_000_000 + 50_000_000 * n
        writer.add_message(channel, log_time=t_ns, data=json.dumps(row).encode(), publish_time=t_ns)
    writer.finish()
    path = tmp_path / "take.mcap"
    path.write_bytes(data.getvalue())
    assert read(path)[0].t_ns.tolist() == [0, 50_000_000, 100_000_000]
    chosen = read(path, names={"Elapsed_Time_In_Milliseconds": "timestamp"})
    assert chosen[0].t_ns.tolist() == [0, 10_000_000, 20_000_000]


def two_gloves():
    data = BytesIO()
    writer = Writer(data)
    writer.start()
    schema = writer.register_schema(name="glove", encoding="jsonschema", data=b"{}")
    for topic in ("/left", "/right", "/battery"):
        channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)
        for t_ns in (0, 10_000_000):
            row = {"volt": 3.5} if topic == "/battery" else dict.fromkeys(COLUMNS, 40.0 + (topic == "/right"))
            writer.add_message(channel, log_time=t_ns, data=json.dumps(row).encode(), publish_time=t_ns)
    writer.finish()
    return data.getvalue()


def test_of_two_gloves_in_an_mcap_file_one_must_be_chosen(tmp_path):
    path = tmp_path / "two.mcap"
    path.write_bytes(two_gloves())
    with pytest.raises(GloveError) as refused:
        read(path)
    assert str(refused.value) == (
        "two.mcap: /left and /right have columns of a glove: choose one (glove.topic)"
    )
    (found,) = read(path, topic="/right")
    assert found.angles_deg[0, 0] == 41.0
    with pytest.raises(GloveError) as refused:
        read(path, topic="/battery")
    assert str(refused.value) == "two.mcap: no topic /battery with columns of a glove; there is /battery"


@pytest.mark.parametrize(("form", "package"), [("hdf5", "h5py"), ("mcap", "mcap"), ("lerobot", "pyarrow")])
def test_a_library_that_is_not_there_is_named_with_the_remedy(tmp_path, monkeypatch, form, package):
    (path,) = write_recordings(tmp_path, [recording()], form)

    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(glove_binary, "importlib", type("Stub", (), {"import_module": staticmethod(missing)}))
    with pytest.raises(GloveError) as refused:
        read(path)
    assert str(refused.value).endswith(f": needs {package}: .venv/bin/pip install -e '.[glove]'")
    assert "\n" not in str(refused.value)
    assert importlib.import_module(package)


def test_a_glove_with_other_names_and_hundredths_of_a_degree_is_read(tmp_path):
    def rename(cells):
        cells[0] = [f"dexcap_{name}" for name in cells[0]]
        for row in cells[1:]:
            row[2:] = [str(round(float(cell) * 100)) for cell in row[2:]]

    names = {name: f"dexcap_{name}" for name in (*COLUMNS, "Elapsed_Time_In_Milliseconds")}
    (found,) = read(csv_file(tmp_path, rename), names=names, unit="cdeg")
    assert np.abs(found.angles_deg - recording().angles_deg).max() <= 0.005 + 1e-5


def test_sources_are_read_in_order_each_with_its_persons_fit(tmp_path):
    write_recordings(tmp_path / "anna", [recording(61, f"take_{n}", seed=n) for n in range(2)], "csv")
    (beas,) = write_recordings(tmp_path / "bea", [recording(121)], "jsonl")
    user = tmp_path / "bea.yaml"
    user.write_text("gain: [0,0,0,0,0,0,0,0,0,0,0,0]\nthumb_spread_gain: 0\n")
    config = GloveConfig(
        sources=(
            GloveSource(files=(str(tmp_path / "anna" / "*.csv"),)),
            GloveSource(files=(str(beas),), user=user),
        )
    )
    found = list(read_actions(config, 3.0))
    assert [(each.source, len(each.actions)) for each in found] == [
        ("take_0.csv", 4),
        ("take_1.csv", 4),
        ("take.jsonl", 7),
    ]
    assert (found[2].actions == -1.0).all() and not (found[0].actions == -1.0).all()
    assert read_demonstrations(config, 3.0).samples == 15
    assert read_demonstrations(GloveConfig(), 3.0) is None


def test_relative_paths_are_meant_from_a_folder_and_absolute_ones_stay():
    source = GloveSource(files=("data/*.csv", "/else/a.csv"), user=Path("anna.yaml"))
    moved = GloveConfig(sources=(source,)).within(Path("/home")).sources[0]
    assert moved.files == ("/home/data/*.csv", "/else/a.csv") and moved.user == Path("/home/anna.yaml")


def test_the_fit_of_nobody_changes_nothing():
    assert GloveUser() == GloveUser(gain=(1.0,) * 12, offset_deg=(0.0,) * 12, thumb_spread_gain=1.0)

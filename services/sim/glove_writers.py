"""Glove recordings as files, in each format that the importer reads, laid out as gloves and tools do it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from common.dexhand021.glove_binary import library
from common.dexhand021.glove_recording import COLUMNS, Recording
from services.sim.glove_person import GLOVE_HZ

TASK = "turn the die in the hand"
TOPIC = "/glove/right"


def _write_csv(path: Path, recording: Recording) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("Frame", "Elapsed_Time_In_Milliseconds", *COLUMNS))
        for number, (t_ns, row) in enumerate(zip(recording.t_ns, recording.angles_deg, strict=True)):
            writer.writerow((number, float(t_ns) / 1e6, *map(str, row)))


def _write_jsonl(path: Path, recording: Recording) -> None:
    rows = (json.dumps({"t_ns": t_ns, **row, "unit": "deg"}) + "\n" for t_ns, row in _rows(recording))
    path.write_text("".join(rows), encoding="utf-8")


def _rows(recording: Recording) -> list[tuple[int, dict[str, float]]]:
    angles = [dict(zip(COLUMNS, map(float, map(str, row)), strict=True)) for row in recording.angles_deg]
    return list(zip(map(int, recording.t_ns), angles, strict=True))


def _write_hdf5(path: Path, recording: Recording) -> None:
    h5py = library("h5py", path.name)
    with h5py.File(path, "w") as file:
        group = file.create_group("demo_0")
        group["time_s"] = recording.t_ns / 1e9
        angles = group.create_dataset("angles", data=recording.angles_deg)
        angles.attrs["columns"] = list(COLUMNS)
        angles.attrs["unit"] = "deg"


def _write_mcap(path: Path, recording: Recording) -> None:
    mcap = library("mcap.writer", path.name)
    properties = {name: {"type": "number"} for name in COLUMNS}
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    with path.open("wb") as file:
        writer = mcap.Writer(file)
        writer.start()
        schema_id = writer.register_schema(name="glove", encoding="jsonschema", data=schema)
        channel = writer.register_channel(topic=TOPIC, message_encoding="json", schema_id=schema_id)
        for number, (t_ns, row) in enumerate(_rows(recording)):
            data = json.dumps({**row, "unit": "deg"}).encode()
            writer.add_message(channel, log_time=t_ns, data=data, publish_time=t_ns, sequence=number)
        writer.finish()


def _write_lerobot(folder: Path, recordings: Sequence[Recording]) -> list[Path]:
    """A LeRobot v2.1 data set: one data file an episode, and what it says of itself."""
    data = folder / "data" / "chunk-000"
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    data.mkdir(parents=True, exist_ok=True)
    begin, episodes = 0, []
    for number, recording in enumerate(recordings):
        _write_parquet(data / f"episode_{number:06d}.parquet", recording, number, begin)
        length = len(recording.t_ns)
        episodes.append({"episode_index": number, "tasks": [TASK], "length": length})
        begin += length
    (folder / "meta" / "info.json").write_text(json.dumps(_info(len(recordings), begin), indent=1))
    (folder / "meta" / "tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": TASK}) + "\n")
    lines = "".join(json.dumps(episode) + "\n" for episode in episodes)
    (folder / "meta" / "episodes.jsonl").write_text(lines)
    return [folder]


def _write_parquet(path: Path, recording: Recording, episode: int, begin: int) -> None:
    pyarrow, parquet = (library(name, path.name) for name in ("pyarrow", "pyarrow.parquet"))
    frames = range(len(recording.t_ns))
    columns = {
        "observation.state": pyarrow.array(recording.angles_deg.tolist(), pyarrow.list_(pyarrow.float32())),
        "timestamp": pyarrow.array(recording.t_ns / 1e9, pyarrow.float32()),
        "frame_index": pyarrow.array(frames, pyarrow.int64()),
        "episode_index": pyarrow.array([episode] * len(frames), pyarrow.int64()),
        "index": pyarrow.array([begin + frame for frame in frames], pyarrow.int64()),
        "task_index": pyarrow.array([0] * len(frames), pyarrow.int64()),
    }
    parquet.write_table(pyarrow.table(columns).replace_schema_metadata({"unit": "deg"}), path)


def _info(episodes: int, frames: int) -> dict[str, Any]:
    single = {name: {"dtype": "int64", "shape": [1], "names": None} for name in _INDICES}
    return {
        "codebase_version": "v2.1",
        "robot_type": "data_glove",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "total_videos": 0,
        "total_chunks": 1,
        "chunks_size": 1000,
        "fps": int(GLOVE_HZ),
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "features": {
            "observation.state": {"dtype": "float32", "shape": [len(COLUMNS)], "names": list(COLUMNS)},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **single,
        },
    }


_INDICES = ("frame_index", "episode_index", "index", "task_index")
_ONE_EACH: Mapping[str, tuple[str, Callable[[Path, Recording], None]]] = MappingProxyType(
    {
        "csv": (".csv", _write_csv),
        "jsonl": (".jsonl", _write_jsonl),
        "hdf5": (".h5", _write_hdf5),
        "mcap": (".mcap", _write_mcap),
    }
)
LEROBOT = "lerobot"
FORMATS: tuple[str, ...] = (*_ONE_EACH, LEROBOT)


def write_recordings(folder: Path, recordings: Sequence[Recording], form: str) -> list[Path]:
    """Write `recordings` into `folder`, named by their source; what `glove.sources` may name comes back.

    Raises ValueError for a format that is none of FORMATS, GloveError without the library for it.
    """
    if form not in FORMATS:
        raise ValueError(f"no format {form!r}; there are {', '.join(FORMATS)}")
    folder.mkdir(parents=True, exist_ok=True)
    if form == LEROBOT:
        return _write_lerobot(folder, recordings)
    suffix, write = _ONE_EACH[form]
    paths = [folder / f"{recording.source}{suffix}" for recording in recordings]
    for path, recording in zip(paths, recordings, strict=True):
        write(path, recording)
    return paths

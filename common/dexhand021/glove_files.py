"""Glove files on disk: which format by their ending, and all recordings of a cell as demonstrations."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common.config import load
from common.demonstrations import Demonstrations
from common.dexhand021.glove import GloveActions, to_actions
from common.dexhand021.glove_binary import read_hdf5, read_mcap, read_parquet
from common.dexhand021.glove_config import GloveConfig, GloveUser
from common.dexhand021.glove_recording import GloveError, Recording, Table, check
from common.dexhand021.glove_text import read_csv, read_jsonl

SUFFIXES = (".csv", ".jsonl", ".parquet", ".h5", ".hdf5", ".mcap")
_LEROBOT_INFO = Path("meta/info.json")


def read_recordings(path: Path, config: GloveConfig) -> list[Recording]:
    """All recordings of a file, or of a LeRobot folder. Raises GloveError."""
    if path.is_dir():
        files = sorted(path.glob("data/**/*.parquet"))
        if not files:
            raise GloveError(f"{path}: is a folder without data/*/*.parquet, so no LeRobot data set")
        return [recording for file in files for recording in read_recordings(file, config)]
    tables = _tables(path, config)
    return [check(table, config.unit, config.max_gap_s, config.names) for table in tables]


def _tables(path: Path, config: GloveConfig) -> list[Table]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise GloveError(f"{path}: cannot be read ({error.strerror})") from None
    name, suffix = path.name, path.suffix.lower()
    if suffix == ".csv":
        return read_csv(data, name)
    if suffix == ".jsonl":
        return read_jsonl(data, name)
    if suffix == ".parquet":
        return read_parquet(data, name, _lerobot_info(path))
    if suffix in (".h5", ".hdf5"):
        return read_hdf5(data, name)
    if suffix == ".mcap":
        return read_mcap(data, name, config.topic, config.names)
    raise GloveError(f"{path}: no format of a glove; there are {', '.join(SUFFIXES)}")


def _lerobot_info(path: Path) -> dict[str, Any] | None:
    """meta/info.json of the data set that a data file lies in, if it does."""
    for folder in path.resolve().parents[:3]:
        file = folder / _LEROBOT_INFO
        if file.is_file():
            try:
                return dict(json.loads(file.read_text(encoding="utf-8")))
            except (OSError, ValueError):
                raise GloveError(f"{file}: is no JSON object") from None
    return None


def read_actions(config: GloveConfig, rate_hz: float) -> Iterator[GloveActions]:
    """Every recording of the section as actions at the control rate. Raises ConfigError in one line."""
    for source in config.sources:
        user = GloveUser() if source.user is None else load(GloveUser, source.user)
        for pattern in source.files:
            for path in _matching(pattern):
                for recording in read_recordings(path, config):
                    yield to_actions(recording, user, rate_hz)


def _matching(pattern: str) -> list[Path]:
    """Files of a pattern in order of name; without a match the name itself, for the error to name it."""
    path = Path(pattern)
    if not any(sign in pattern for sign in "*?["):
        return [path]
    found = Path(path.anchor).glob(str(path.relative_to(path.anchor)))
    return sorted(found) or [path]


def read_demonstrations(config: GloveConfig, rate_hz: float) -> Demonstrations | None:
    """What the warm-up replays; None without sources. Raises ConfigError in one line."""
    if not config.sources:
        return None
    return Demonstrations([each.actions for each in read_actions(config, rate_hz)])

"""Which camera to read from: a folder with a recording, or a RealSense."""

# pyright: strict

from __future__ import annotations

from pathlib import Path

from common.config import load
from services.perception.config import SourceConfig
from services.perception.frames import FrameSource
from services.perception.recording import Player


def open_source(config: SourceConfig) -> FrameSource | None:
    """Open it; None when frames come over the bus. Raises ValueError or OSError when it is not there."""
    if config.kind == "bus":
        return None
    if config.folder is None:
        raise ValueError("source.folder: missing; name the folder with the recording")
    return Player(config.folder, config.repeat)


def source_at(path: Path) -> FrameSource:
    """The recording in a folder, or the camera that a YAML file describes. Raises ConfigError, ValueError."""
    if path.is_dir():
        return Player(path)
    source = open_source(load(SourceConfig, path))
    if source is None:
        raise ValueError(f"{path}: describes no camera that could be opened here")
    return source

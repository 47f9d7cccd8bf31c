"""Which camera to read from: a RealSense, a recording of its SDK, or a folder with a recording of ours."""

# pyright: strict

from __future__ import annotations

from pathlib import Path

from common.config import load
from services.perception import realsense
from services.perception.config import SourceConfig
from services.perception.frames import FrameSource
from services.perception.realsense import RealsenseSource
from services.perception.recording import Player

SDK_SUFFIXES = (".bag", ".db3")


def open_source(config: SourceConfig) -> FrameSource:
    """Open it. Raises ValueError, OSError, RuntimeError when it is not there, ImportError without SDK."""
    if config.kind == "realsense":
        stream = realsense.live(config.serial or None, config.width, config.height, config.rate_hz)
        return RealsenseSource(stream)
    if config.kind == "bus" or config.path is None:
        raise ValueError("source.path: missing: which recording?" if config.path is None else "source: a bus")
    if config.path.suffix in SDK_SUFFIXES:
        return RealsenseSource(realsense.playback(config.path))
    return Player(config.path, config.repeat)


def source_at(path: Path) -> FrameSource:
    """The recording at a path, or the camera that a YAML file describes. Raises as above, and ConfigError."""
    if path.is_dir() or path.suffix in SDK_SUFFIXES:
        return open_source(SourceConfig(kind="recording", path=path))
    return open_source(load(SourceConfig, path))

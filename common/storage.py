"""A file that is either wholly there or not there at all, whenever the power fails."""

from __future__ import annotations

import os
from pathlib import Path

# The dot and the suffix keep a half-written file out of every listing.
TEMPORARY = ".*.partial"


def write_atomically(path: Path, payload: bytes) -> None:
    """Write `payload` under `path` so that after the return it survives a crash."""
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("wb") as file:
        file.write(payload)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)  # the rename itself
    finally:
        os.close(directory)


def sweep_partial(directory: Path) -> int:
    """Delete what writers that died left half-written; returns how many."""
    leftovers = list(directory.glob(TEMPORARY))
    for path in leftovers:
        path.unlink(missing_ok=True)
    return len(leftovers)

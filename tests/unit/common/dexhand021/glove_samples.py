"""Recordings to test with: every cell different, in each of the formats."""

from __future__ import annotations

import numpy as np

from common.dexhand021.glove_config import GloveConfig
from common.dexhand021.glove_files import read_recordings
from common.dexhand021.glove_recording import COLUMNS, Recording
from services.sim.glove_writers import write_recordings

AS_IT_IS = GloveConfig()


def recording(rows=30, source="take", seed=0, hz=60):
    angles = np.random.default_rng(seed).uniform(-20, 90, (rows, 20)).astype(np.float32)
    return Recording(source, np.rint(np.arange(rows) * 1e9 / hz).astype(np.int64), angles)


def csv_file(tmp_path, change=lambda rows: None, rows=30, name="take.csv"):
    """A Manus file whose lines `change` may spoil: a list of lists of text, the header first."""
    (path,) = write_recordings(tmp_path, [recording(rows)], "csv")
    cells = [line.split(",") for line in path.read_text().splitlines()]
    change(cells)
    path = path.with_name(name)
    path.write_text("".join(",".join(line) + "\n" for line in cells))
    return path


def read(path, **options):
    return read_recordings(path, GloveConfig(**options))


def column(name):
    """Its index in a Manus file of the generator."""
    return 2 + COLUMNS.index(name)


def same(found, wanted):
    return np.array_equal(found.t_ns, wanted.t_ns) and np.array_equal(found.angles_deg, wanted.angles_deg)

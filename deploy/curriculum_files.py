"""What the curriculum keeps on disk: finished episodes, one line each, and where it is in its run.

`curriculum.json` is replaced as a whole and names the length of `episodes.jsonl` that belongs to it, so that
after any crash lines that are not accounted for are cut off, and none is ever written twice.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import cast

from pydantic import ValidationError

from common.config import ConfigError, Frozen
from common.storage import write_atomically
from deploy.schedule import Progress
from deploy.scores import Row

ROWS_FILE = "episodes.jsonl"
STATE_FILE = "curriculum.json"


class _State(Frozen):
    task: str
    seed: int
    rows_bytes: int  # length of episodes.jsonl that this state knows of
    progress: Progress


class CurriculumFiles:
    """The two files of one run; `commit` is called by one job at a time."""

    def __init__(self, directory: Path, task: str, seed: int) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._rows = directory / ROWS_FILE
        self._state = directory / STATE_FILE
        self._task, self._seed = task, seed
        self._bytes = 0

    def load(self) -> tuple[Progress, list[Row]]:
        """Return where the run was and its finished episodes. Raises ConfigError if it is another's run."""
        if not self._state.exists():
            self._refuse_foreign_rows()
            return Progress(), []
        state = self._read_state()
        self._bytes = state.rows_bytes
        lines = self._rows.read_bytes()[: self._bytes] if self._rows.exists() else b""
        if len(lines) < self._bytes:
            raise ConfigError(
                [f"{self._rows}: is shorter than {STATE_FILE} says; restore it or move both away"]
            )
        return state.progress, [json.loads(line) for line in lines.splitlines()]

    def _refuse_foreign_rows(self) -> None:
        if self._rows.exists() and self._rows.stat().st_size:
            raise ConfigError([f"{self._rows}: holds results but {STATE_FILE} is missing; move them away"])

    def _read_state(self) -> _State:
        try:
            state = _State.model_validate_json(self._state.read_bytes())
        except (OSError, ValidationError):
            raise ConfigError([f"{self._state}: cannot be read; move the run away to begin anew"]) from None
        if (state.task, state.seed) != (self._task, self._seed):
            found = f"task {state.task}, seed {state.seed}"
            raise ConfigError([f"{self._state}: belongs to a run with {found}; choose another run_dir"])
        return state

    def commit(self, progress: Progress, rows: tuple[Row, ...]) -> None:
        """Add finished episodes and replace the state; when this returns both survive a crash."""
        text = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode()
        if rows:
            self._append(text)
        length = self._bytes + len(text)
        state = _State(task=self._task, seed=self._seed, rows_bytes=length, progress=progress)
        write_atomically(self._state, state.model_dump_json(indent=1).encode())
        self._bytes = length

    def _append(self, text: bytes) -> None:
        with self._rows.open("ab") as file:
            file.truncate(self._bytes)  # drops what a commit that failed half-way has left
            file.write(text)
            file.flush()
            os.fsync(file.fileno())


def read_rows(directory: Path) -> list[Row]:
    """Return the finished episodes of a run, of a running one too; a torn last line is left out."""
    text = (directory / ROWS_FILE).read_text(encoding="utf-8")
    return [cast(Row, json.loads(line)) for line in text[: text.rfind("\n") + 1].splitlines()]

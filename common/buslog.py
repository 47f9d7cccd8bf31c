"""The bus log: what one process received, decided and sent, as exactly the wire bytes, in bounded files.

A log is a stream of MessagePack arrays `[kind, t_ns, key, payload]`. `step` marks each call of the service
(payload: ticks); `in` and `result` stand before the step that saw them, `out` after it.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import BinaryIO, Protocol, cast

import msgpack

# msgpack ships no type stubs.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false

MAX_ENTRY_BYTES = 512 * 1024 * 1024
_END_OF_TIME_NS = 2**63
KINDS = ("in", "result", "step", "out")


@dataclass(frozen=True)
class Entry:
    """One line of a log; `t_ns` is the time of the step that it belongs to."""

    kind: str
    t_ns: int
    key: str
    payload: bytes


class LogSink(Protocol):
    """Where a runner writes entries."""

    failed: str  # why nothing is written any more; empty: all is well

    def write(self, entry: Entry) -> None:
        """Append one entry."""
        ...

    def flush(self) -> None:
        """Hand what is buffered to the operating system."""
        ...

    def close(self) -> None:
        """Flush and end."""
        ...


class NoLog:
    """Discards everything."""

    failed = ""

    def write(self, entry: Entry) -> None:
        """Do nothing."""

    def flush(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class BusLog:
    """Writes `<name>-<boot>-<n>.buslog` files, each at most `segment_bytes`, and deletes the oldest.

    Files of earlier boots of the same process count towards `keep_bytes` and are deleted first.
    """

    failed = ""  # it raises OSError instead

    def __init__(self, directory: Path, name: str, boot_id: int, segment_bytes: int, keep_bytes: int) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._directory = directory
        self._name = name
        self._boot = boot_id
        self._segment_bytes = segment_bytes
        self._keep_bytes = keep_bytes
        self._number = 0
        self._size = 0
        self._file = self._open()
        self._delete_oldest()

    def _open(self) -> BinaryIO:
        self._size = 0
        path = self._directory / f"{self._name}-{self._boot:020d}-{self._number:04d}.buslog"
        self._number += 1
        return path.open("wb", buffering=1 << 18)

    def write(self, entry: Entry) -> None:
        """Append one entry; begin a new file when this one is full."""
        packed = cast(bytes, msgpack.packb((entry.kind, entry.t_ns, entry.key, entry.payload)))
        if self._size and self._size + len(packed) > self._segment_bytes:
            self._file.close()
            self._file = self._open()
            self._delete_oldest()
        self._size += len(packed)
        self._file.write(packed)

    def _delete_oldest(self) -> None:
        # Files may be changed within one tick of the file system's clock; then their number decides.
        paths = sorted(
            self._directory.glob(f"{self._name}-*.buslog"),
            key=lambda path: (path.stat().st_mtime_ns, path.name),
        )
        total = sum(path.stat().st_size for path in paths)
        for path in paths[:-1]:
            if total <= self._keep_bytes:
                return
            total -= path.stat().st_size
            path.unlink()

    def flush(self) -> None:
        """Hand what is buffered to the operating system: a killed process loses at most what came after."""
        self._file.flush()

    def close(self) -> None:
        """Flush and end."""
        self._file.close()


class BackgroundLog:
    """Has another log written by a thread of its own: packing and writing a snapshot takes 7 to 12 ms.

    `write` only notes the entry; `flush` hands all that were noted to the thread. A disk that refuses ends
    the log, not the service: `failed` then says why, and goes into the heartbeat.
    """

    def __init__(self, log: LogSink) -> None:
        self._log = log
        self._noted: list[Entry] = []
        self._handed: SimpleQueue[list[Entry] | None] = SimpleQueue()
        self.failed = ""
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def write(self, entry: Entry) -> None:
        """Note one entry."""
        self._noted.append(entry)

    def flush(self) -> None:
        """Have the noted entries written soon: a killed process loses at most what came after."""
        if not self.failed:
            self._handed.put(self._noted)
        self._noted = []

    def close(self) -> None:
        """Have everything written, then end."""
        self.flush()
        self._handed.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            while (entries := self._handed.get()) is not None:
                for entry in entries:
                    self._log.write(entry)
                self._log.flush()
            self._log.close()
        except OSError as error:
            self.failed = f"log ended: {error.strerror or error}"


def read_log(path: Path) -> Iterator[Entry]:
    """Yield the entries of one file; a torn last entry (the process was killed) ends it silently."""
    with path.open("rb") as file:
        unpacker = msgpack.Unpacker(file, raw=False, max_buffer_size=MAX_ENTRY_BYTES)
        while True:
            try:
                entry = _entry(cast(object, unpacker.unpack()))
            except (msgpack.OutOfData, ValueError):
                return
            if entry is None:
                return
            yield entry


def _entry(item: object) -> Entry | None:
    if not isinstance(item, list) or len(cast(list[object], item)) != 4:
        return None
    kind, t_ns, key, payload = cast(list[object], item)
    if not isinstance(kind, str) or kind not in KINDS:
        return None
    if isinstance(t_ns, int) and isinstance(key, str) and isinstance(payload, bytes):
        return Entry(kind, t_ns, key, payload)
    return None


def log_files(directory: Path, name: str = "*") -> list[Path]:
    """Return the log files of a run (of one process, if named) in the order in which they were begun."""
    return sorted(directory.glob(f"{name}-*-*.buslog"), key=lambda path: (_first_ns(path), path.name))


def _first_ns(path: Path) -> int:
    """Time of the first entry, for boot ids in the names are random; a file still empty comes last."""
    first = next(read_log(path), None)
    return first.t_ns if first else _END_OF_TIME_NS

"""A pose estimator in a process and a Python environment of its own, asked over pipes, within a time."""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from services.perception.foundationpose_worker import Arrays, receive, send

_LINES = 3  # of the process's last words that an error quotes


class ForeignError(RuntimeError):
    """The process could not be started, died, hung, or refused; the text says which, and what it said."""


class ForeignProcess:
    """Started at the first request, and again at the first one after it ended; one request at a time."""

    def __init__(self, command: Sequence[str], folder: Path, log: Path) -> None:
        self._command, self._folder, self._log = list(command), folder, log
        self._process: subprocess.Popen[bytes] | None = None
        self._one = threading.Lock()

    @property
    def running(self) -> bool:
        """Whether what earlier requests told it is still known."""
        return self._process is not None and self._process.poll() is None

    def ask(self, header: dict[str, Any], arrays: Arrays | None, timeout_s: float) -> dict[str, Any]:
        """Send a request, return the reply's header. Raises ForeignError; after a time-out it is killed."""
        with self._one:
            process = self._process if self.running else self._start()
            assert process is not None and process.stdin is not None and process.stdout is not None
            begin = time.monotonic()
            killer = threading.Timer(timeout_s, process.kill)
            killer.start()
            try:
                send(process.stdin, header, arrays)  # pyright: ignore[reportArgumentType]
                reply, _ = receive(process.stdout)  # pyright: ignore[reportArgumentType]
            except (EOFError, OSError, ValueError) as error:
                late = time.monotonic() - begin >= timeout_s
                process.kill()
                process.wait()
                raise ForeignError(self._why(header, timeout_s, late)) from error
            finally:
                killer.cancel()
        if "error" in reply:
            raise ForeignError(f"{header['do']}: {reply['error']}")
        return reply

    def _start(self) -> subprocess.Popen[bytes]:
        self.close()
        try:
            with self._log.open("wb") as stream:
                self._process = subprocess.Popen(
                    self._command,
                    cwd=self._folder,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=stream,
                )
        except OSError as error:
            raise ForeignError(f"{self._command[0]}: cannot be started: {error.strerror}") from None
        return self._process

    def _why(self, header: dict[str, Any], timeout_s: float, late: bool) -> str:
        if late:
            return f"{header['do']}: no answer within {timeout_s:g} s: ended"
        words = self._log.read_text(errors="replace").strip().splitlines()[-_LINES:]
        return f"{header['do']}: it ended: {' | '.join(words) or 'without a word'} ({self._log})"

    def close(self) -> None:
        """End it."""
        process, self._process = self._process, None
        if process is None:
            return
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        process.kill()
        process.wait()

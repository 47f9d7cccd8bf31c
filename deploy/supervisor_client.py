"""Talking to supervisord over its unix socket, with a timeout on everything."""

from __future__ import annotations

import http.client
import socket
import time
import xmlrpc.client
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

POLL_S = 0.1
_NOTHING_TO_DO = {60, 70, 90}  # faults: already started, not running, abnormal termination


class SupervisorError(Exception):
    """supervisord did not answer or refused; the text is one line for people."""


@dataclass(frozen=True)
class ProcessInfo:
    """What supervisord knows of one process."""

    name: str
    state: str  # STOPPED STARTING RUNNING BACKOFF STOPPING EXITED FATAL UNKNOWN
    pid: int  # 0: none
    exit_code: int  # of the last exit, in state EXITED only
    uptime_s: float
    reason: str  # why the last start failed, if it did

    @property
    def alive(self) -> bool:
        """Whether there is a process now."""
        return self.state in ("STARTING", "RUNNING", "STOPPING")

    @property
    def finished(self) -> bool:
        """Whether it ended by itself with exit code 0."""
        return self.state == "EXITED" and self.exit_code == 0


class SupervisorClient:
    """One supervisord; every call may raise SupervisorError."""

    def __init__(self, path: Path, timeout_s: float = 5.0) -> None:
        self.path = path
        self._transport = _UnixTransport(path, timeout_s)

    def running(self) -> bool:
        """Whether a supervisord answers on the socket."""
        try:
            self._call("getState")
        except SupervisorError:
            return False
        return True

    def processes(self) -> dict[str, ProcessInfo]:
        """Return the state of each process by name."""
        return {item["name"]: _info(item) for item in self._call("getAllProcessInfo")}

    def stop(self, name: str) -> None:
        """Ask a process to end; returns at once."""
        self._call("stopProcess", name, False)

    def kill(self, name: str) -> None:
        """End a process that does not listen (signal 9)."""
        self._call("signalProcess", name, "KILL")

    def start(self, name: str) -> None:
        """Start a process; returns at once."""
        self._call("startProcess", name, False)

    def shutdown(self) -> None:
        """End supervisord and whatever still runs under it; returns at once."""
        self._call("shutdown")

    def restart(self, name: str, patience_s: float) -> None:
        """Stop a process, with signal 9 after `patience_s`, and start it again."""
        self.stop_all([name], patience_s)
        self.start(name)

    def stop_all(self, names: Sequence[str], patience_s: float) -> None:
        """Stop processes together; those still there after `patience_s` are killed."""
        for name in names:
            self.stop(name)
        if wait_until(lambda: not self._alive(names), patience_s):
            return
        for name in self._alive(names):
            self.kill(name)
        wait_until(lambda: not self._alive(names), 1.0)

    def _alive(self, names: Sequence[str]) -> list[str]:
        known = self.processes()
        return [name for name in names if name in known and known[name].alive]

    def _call(self, method: str, *arguments: object) -> Any:
        server = xmlrpc.client.ServerProxy("http://localhost", transport=self._transport)
        try:
            return getattr(server.supervisor, method)(*arguments)
        except xmlrpc.client.Fault as fault:
            if fault.faultCode in _NOTHING_TO_DO:
                return None
            raise SupervisorError(f"supervisord: {method} {arguments}: {fault.faultString}") from None
        except (OSError, http.client.HTTPException, xmlrpc.client.Error) as error:
            self._transport.close()
            raise SupervisorError(f"supervisord does not answer at {self.path}: {error}") from None


def wait_until(condition: Callable[[], bool], patience_s: float) -> bool:
    """Poll `condition`; returns whether it came true in time."""
    deadline = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_S)
    return True


def _info(item: dict[str, Any]) -> ProcessInfo:
    return ProcessInfo(
        name=item["name"],
        state=item["statename"],
        pid=item["pid"],
        exit_code=item["exitstatus"],
        uptime_s=float(item["now"] - item["start"]) if item["start"] else 0.0,
        reason=item["spawnerr"],
    )


class _UnixTransport(xmlrpc.client.Transport):
    """XML-RPC over a unix socket."""

    def __init__(self, path: Path, timeout_s: float) -> None:
        super().__init__()
        self._path = path
        self._timeout_s = timeout_s

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        del host  # the path says it all
        connection = _UnixConnection("localhost", timeout=self._timeout_s)
        connection.path = self._path
        return connection


class _UnixConnection(http.client.HTTPConnection):
    path: Path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self.path))

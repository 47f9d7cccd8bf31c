"""Starting, judging and stopping the processes of one machine."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from common.dexhand021.glove_files import read_demonstrations
from common.zenoh_bus import BusError, ZenohBus
from deploy.cell import ALL_LOCAL, Cell, instances_of, write_process_configs
from deploy.monitor import Heard, Monitor
from deploy.processes import process_of
from deploy.supervisor import REPOSITORY, RunFiles, render
from deploy.supervisor_client import ProcessInfo, SupervisorClient, SupervisorError, wait_until

OPERATOR = "operator"  # our own name on the bus
SUPERVISOR_START_S = 15.0
WAVE_PATIENCE_S = (3.5, 2.0, 2.0, 1.0)  # per stop wave, before signal 9
BUS_ATTEMPT_S = 2.0
LOG_LINES = 12


class LaunchError(Exception):
    """Something keeps the cell from running; the text tells people what, where and what to do."""


class Launch:
    """The processes of one machine of a cell, under one supervisord."""

    def __init__(self, cell: Cell, machine: str = ALL_LOCAL) -> None:
        self.cell = cell
        self.instances = instances_of(cell, machine)
        self.files = RunFiles(cell.run_dir, machine)
        self.client = SupervisorClient(self.files.socket)
        self.started = False  # by us
        self._given_up: set[str] = set()  # optional processes that were warned of
        self.has_router = "router" in self.instances

    def start(self) -> None:
        """Write all files and start supervisord. Raises LaunchError, ConfigError."""
        self._refuse_if_running()
        if any("glove" in process_of(name).sections for name in self.instances):
            read_demonstrations(self.cell.glove, self.cell.control.rate_hz)  # a bad file is told of here
        write_process_configs(self.cell, self.files.machine)
        self.files.supervisor_config.write_text(render(self.files, self.instances), encoding="utf-8")
        self.started = True
        command = [
            sys.executable,
            "-m",
            "supervisor.supervisord",
            "-n",
            "-c",
            str(self.files.supervisor_config),
        ]
        out = self.files.supervisor_log.with_suffix(".out")
        with out.open("wb") as stream:
            # A session of its own: Ctrl-C in this terminal must reach only us, so that we stop it in order.
            self._process = subprocess.Popen(
                command,
                cwd=REPOSITORY,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                start_new_session=True,
            )
        if not wait_until(
            lambda: self.client.running() or self._process.poll() is not None, SUPERVISOR_START_S
        ):
            raise LaunchError(f"supervisord does not answer: see {out}")
        if self._process.poll() is not None:
            raise LaunchError(f"supervisord did not start:\n{last_lines(out)}")

    def _refuse_if_running(self) -> None:
        if self.client.running():
            raise LaunchError(
                f"already running in {self.cell.run_dir}: stop it first, with the command `down`"
            )
        left = orphans(self.cell.run_dir, self.instances)
        if left:
            names = ", ".join(f"{name} (pid {pid})" for name, pid in left.items())
            raise LaunchError(
                f"left over from an earlier run in {self.cell.run_dir}: {names}; end it with `down`"
            )

    def connect(
        self, say: Callable[[str], None], cancelled: Callable[[], bool], patience_s: float
    ) -> Monitor | None:
        """Join the bus; None when cancelled. Raises LaunchError when there is no router in time."""
        deadline = time.monotonic() + patience_s
        while not cancelled():
            try:
                return self.join_bus()
            except BusError as error:
                if self.has_router:
                    self.check(self.client.processes(), say)
                if time.monotonic() > deadline:
                    why = self._why("router", "cannot be reached") if self.has_router else str(error)
                    raise LaunchError(why) from None
        return None

    def join_bus(self) -> Monitor:
        """Listen to the cell. Raises BusError when there is no router within two seconds."""
        quick = self.cell.bus.model_copy(update={"connect_timeout_s": BUS_ATTEMPT_S})
        return Monitor(ZenohBus(quick, self.cell.cell, OPERATOR), self.cell)

    def wait_healthy(
        self,
        monitor: Monitor,
        say: Callable[[str], None],
        cancelled: Callable[[], bool],
        names: tuple[str, ...],
    ) -> tuple[str, ...]:
        """Wait until each of `names` works, or for a cancel; return the optional ones that do not.

        Raises LaunchError naming a required one that does not.
        """
        begin = time.monotonic()
        waiting = list(names)
        while waiting and not cancelled():
            infos = self.client.processes()
            heard = monitor.poll()
            for name in [name for name in waiting if is_healthy(name, infos[name], heard)]:
                waiting.remove(name)
                say(f"{name}: {heard[name].health.state if name in heard else 'up'}")
            self.check(infos, say)
            self._check_deadlines(waiting, time.monotonic() - begin, say)
            waiting = [name for name in waiting if name not in self._given_up]
            time.sleep(0.2)
        return tuple(name for name in names if name in self._given_up)

    def _check_deadlines(self, waiting: list[str], elapsed_s: float, say: Callable[[str], None]) -> None:
        for name in waiting:
            if elapsed_s > process_of(name).start_deadline_s:
                self._give_up(name, f"is not healthy after {elapsed_s:.0f} s", say)

    def check(self, infos: dict[str, ProcessInfo], say: Callable[[str], None]) -> None:
        """Raise LaunchError for a required process that supervisord has given up; tell of others once."""
        for name in self.instances:
            if infos[name].state == "FATAL":
                self._give_up(name, "fails again and again", say)

    def _give_up(self, name: str, what: str, say: Callable[[str], None]) -> None:
        if process_of(name).required:
            raise LaunchError(self._why(name, what))
        if name not in self._given_up:
            self._given_up.add(name)
            say(f"going on without {self._why(name, what)}")

    def _why(self, name: str, what: str) -> str:
        log = self.files.log_of(name)
        return f"{name} {what}; the end of {log}:\n{last_lines(log)}"

    def stop(self) -> None:
        """Stop all processes in order, then supervisord.

        Takes under ten seconds, unless processes of several waves do not listen and must be killed.
        """
        try:
            alive = [name for name, info in self.client.processes().items() if info.state != "EXITED"]
            for wave, patience_s in enumerate(WAVE_PATIENCE_S):
                self.client.stop_all(
                    [name for name in alive if process_of(name).stop_wave == wave], patience_s
                )
            self.client.shutdown()
        except SupervisorError:
            pass  # it is gone already; what it left behind is ended below
        pid_file = self.files.supervisor_log.with_suffix(".pid")
        wait_until(lambda: not pid_file.exists() or not self.client.running(), 2.0)
        end_orphans(self.cell.run_dir, self.instances)
        self.files.socket.unlink(missing_ok=True)


def is_healthy(name: str, info: ProcessInfo, heard: dict[str, Heard]) -> bool:
    """Whether a process works: it is heard, or it is there and needs no heartbeat, or it is finished."""
    if info.finished:
        return True
    if not process_of(name).heartbeat:
        return info.alive
    return info.alive and name in heard and heard[name].fresh


def orphans(run_dir: Path, instances: tuple[str, ...]) -> dict[str, int]:
    """Find processes that outlived their supervisord, by the configuration file that they were given."""
    configs = {str(RunFiles(run_dir).config_of(name)): name for name in instances}
    found: dict[str, int] = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue  # ended meanwhile
        if "--config" in words and (name := configs.get(words[words.index("--config") + 1])):
            found[name] = int(path.parent.name)
    return found


def end_orphans(run_dir: Path, instances: tuple[str, ...], patience_s: float = 3.0) -> None:
    """End what `orphans` finds: asked first, then by force."""
    for kind in (signal.SIGTERM, signal.SIGKILL):
        for pid in orphans(run_dir, instances).values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, kind)
        if wait_until(lambda: not orphans(run_dir, instances), patience_s):
            return


def last_lines(path: Path, count: int = LOG_LINES) -> str:
    """Return the end of a text file, indented; says so when there is nothing."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    return "\n".join(f"    {line}" for line in lines[-count:] or ["(it has printed nothing)"])

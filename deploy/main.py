"""`deploy/run_all.sh` after the bootstrap: starts, shows, inspects and stops a cell."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Mapping

from common.config import ConfigError
from common.zenoh_bus import ZenohBus
from common.zenoh_router import BusError
from deploy.arguments import USAGE, Arguments, UsageError, parse
from deploy.cell import ALL_LOCAL, instances_of, load_cell, on_this_machine
from deploy.curve import CURVE_FILE, EPISODES_FILE, draw, read_episodes
from deploy.launch import OPERATOR, Launch, LaunchError, orphans
from deploy.monitor import Heard, Monitor
from deploy.processes import WATCHDOG
from deploy.progress import Display, figures
from deploy.status import restarts, rows, table, tallies
from deploy.summary import summarise
from deploy.supervisor_client import ProcessInfo, SupervisorError

ROUTER_PATIENCE_S = 30.0
LISTEN_S = 2.5  # for `status`: a working process is heard several times
SHOW_EVERY_S = 0.5
INTERRUPTED = 128


def main(argv: list[str]) -> int:
    """Do what the command line says and return the exit code; an error is told in a few lines.

    Exit codes: 0 done, 1 something failed, 2 wrong command line or cell, 128 + n ended by signal n.
    """
    try:
        arguments = parse(argv)
        if arguments.help:
            print(USAGE)
            return 0
        return Operator(arguments).do()
    except (UsageError, ConfigError) as error:
        print(error, file=sys.stderr)
        return 2
    except (LaunchError, BusError, SupervisorError) as error:
        print(error, file=sys.stderr)
        return 1


class Operator:
    """One command on one machine's part of a cell. Raises ConfigError for an unusable cell."""

    def __init__(self, arguments: Arguments) -> None:
        self._arguments = arguments
        cell = load_cell(arguments.cell, arguments.overrides)
        self._machine = arguments.machine or ALL_LOCAL
        self._cell = cell if arguments.machine else on_this_machine(cell)
        self._launch = Launch(self._cell, self._machine)
        self._stop = threading.Event()
        self._signal = 0

    def do(self) -> int:
        """Carry out the command."""
        commands = {
            "run": self.run,
            "up": self.up,
            "down": self.down,
            "status": self.status,
            "logs": self.logs,
            "restart": self.restart,
        }
        return commands[self._arguments.command]()

    def run(self) -> int:
        """Start, show progress until the curriculum is done, stop, summarise."""
        self._catch_signals()
        heard: dict[str, Heard] = {}
        with Display(f"{self._cell.cell} · {self._cell.task}") as display:
            try:
                monitor = self._start(display)
                if monitor:
                    heard = self._watch(monitor, display)
            finally:
                if self._launch.started:  # and not refused because of another run in the same place
                    display.say("stopping")
                    self._launch.stop()
        if not self._signal:  # who interrupts does not want to wait for a drawing
            draw(read_episodes(self._cell.run_dir / EPISODES_FILE), self._cell.run_dir / CURVE_FILE)
        summarise(self._cell, heard, print)
        if self._signal:
            print("stopped before the end; the same command goes on from here")
        return INTERRUPTED + self._signal if self._signal else 0

    def up(self) -> int:
        """Start in the background; everything is stopped again if a service does not become healthy."""
        self._catch_signals()
        with Display(self._cell.cell) as display:
            try:
                self._start(display)
            except (LaunchError, SupervisorError):
                if self._launch.started:
                    self._launch.stop()
                raise
            if self._stop.is_set():
                self._launch.stop()
                return INTERRUPTED + self._signal
        print("running in the background: `status` shows it, `down` stops it")
        return 0

    def down(self) -> int:
        """Stop whatever of this machine's part is there."""
        left = orphans(self._cell.run_dir, self._launch.instances)
        if not left and not self._launch.client.running():
            print(f"not running in {self._cell.run_dir}")
            return 0
        begin = time.monotonic()
        self._launch.stop()
        print(f"stopped in {time.monotonic() - begin:.1f} s")
        return 0

    def status(self) -> int:
        """Print the health table; 1 if any process has a problem."""
        running = self._launch.client.running()
        infos = self._launch.client.processes() if running else {}
        heard = self._listen()
        counts = restarts(self._launch.files.supervisor_log)
        found = rows(self._everything(), infos, heard, self._cell.config_hash, counts)
        print(table(found))
        print(tallies(heard))
        if not running:
            print(f"nothing is supervised in {self._cell.run_dir} (machine {self._machine})")
        return int(not running or any(row.problem for row in found))

    def logs(self) -> int:
        """Show the end of the logs, and what follows when a person is watching."""
        names = [self._known(self._arguments.service)] if self._arguments.service else self._launch.instances
        files = [str(path) for name in names if (path := self._launch.files.log_of(name)).is_file()]
        if not files:
            raise LaunchError(f"no log in {self._launch.files.log_dir}")
        follow = ["-F"] if sys.stdout.isatty() else []
        os.execvp("tail", ["tail", "-n", "200" if self._arguments.service else "20", *follow, *files])

    def restart(self) -> int:
        """Stop and start one service and wait until it is healthy."""
        name = self._known(self._arguments.service or "")
        self._launch.client.restart(name, patience_s=5.0)
        monitor = self._launch.connect(print, self._stop.is_set, ROUTER_PATIENCE_S)
        if not monitor:
            return 0
        monitor.poll()
        failed = self._launch.wait_healthy(monitor, print, self._stop.is_set, (name,))
        monitor.close()
        return int(bool(failed))

    def _known(self, service: str) -> str:
        """Return the instance that the user means. Raises LaunchError."""
        for name in self._launch.instances:
            if service == name or (service == WATCHDOG and name.startswith(WATCHDOG)):
                return name
        raise LaunchError(f"{service}: no such service here; choose from {' '.join(self._launch.instances)}")

    def _everything(self) -> tuple[str, ...]:
        """Name the processes of all machines of the cell."""
        if self._machine == ALL_LOCAL:
            return self._launch.instances
        return tuple(name for machine in self._cell.machines for name in instances_of(self._cell, machine))

    def _start(self, display: Display) -> Monitor | None:
        if not self._launch.has_router:  # then another machine must be up already
            ZenohBus(self._cell.bus, self._cell.cell, OPERATOR).close()
        self._launch.start()
        display.say(f"starting {' '.join(self._launch.instances)} in {self._cell.run_dir}")
        monitor = self._launch.connect(display.say, self._stop.is_set, ROUTER_PATIENCE_S)
        names = self._launch.instances
        failed = self._launch.wait_healthy(monitor, display.say, self._stop.is_set, names) if monitor else ()
        if "viewer" in names and "viewer" not in failed and self._cell.viewer.serve:
            display.say(f"dashboard: http://{self._cell.viewer.bind}:{self._cell.viewer.web_port}")
        return monitor

    def _watch(self, monitor: Monitor, display: Display) -> dict[str, Heard]:
        """Show progress until the run is done or a signal arrives; what was heard last.

        Raises LaunchError if a process fails.
        """
        heard: dict[str, Heard] = {}
        while not self._stop.wait(SHOW_EVERY_S):
            heard = monitor.poll()
            infos = self._launch.client.processes()
            display.show(figures(heard, monitor.metrics))
            if is_done(heard, infos):
                break
            self._launch.check(infos, display.say)
        return heard

    def _listen(self) -> dict[str, Heard]:
        """Hear every process that works; nothing when there is no router."""
        try:
            monitor = self._launch.join_bus()
        except BusError as error:
            print(error, file=sys.stderr)
            return {}
        heard: dict[str, Heard] = {}
        deadline = time.monotonic() + LISTEN_S
        while time.monotonic() < deadline:
            heard = monitor.poll()
            time.sleep(0.1)
        monitor.close()
        return heard

    def _catch_signals(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._note_signal)

    def _note_signal(self, number: int, _frame: object) -> None:
        self._signal = number
        self._stop.set()


def is_done(heard: Mapping[str, Heard], infos: Mapping[str, ProcessInfo]) -> bool:
    """Whether the curriculum has finished: it says so, or it has ended without an error."""
    if "curriculum" in heard and heard["curriculum"].health.fields.get("done") == 1.0:
        return True
    return "curriculum" in infos and infos["curriculum"].finished


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

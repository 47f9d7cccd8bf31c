"""supervisord for the processes of one machine: its files and its configuration."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common.config import ConfigError
from deploy.processes import PROCESSES, Process, process_of

REPOSITORY = Path(__file__).resolve().parents[1]
STOP_WAIT_S = 10
START_RETRIES = 2
LOG_MB = 5
LOG_BACKUPS = 3
SOCKET_PATH_LIMIT = 100  # the kernel allows 107 bytes, supervisord adds a suffix while it binds

# One thread a process unless its own section asks for more: libraries that each take all cores fight.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


@dataclass(frozen=True)
class RunFiles:
    """Where one machine's part of a run keeps its files; `machine` is `local` when there is only one."""

    run_dir: Path
    machine: str = "local"

    @property
    def config_dir(self) -> Path:
        """Folder of the rendered configuration of each process."""
        return self.run_dir / "config"

    @property
    def log_dir(self) -> Path:
        """Folder of what the processes print."""
        return self.run_dir / "logs"

    @property
    def socket(self) -> Path:
        """Where supervisord answers."""
        return self.run_dir / f"supervisor-{self.machine}.sock"

    @property
    def supervisor_config(self) -> Path:
        """The rendered supervisord.conf."""
        return self.config_dir / f"supervisord-{self.machine}.conf"

    @property
    def supervisor_log(self) -> Path:
        """What supervisord itself reports: starts, exits, failures."""
        return self.log_dir / f"supervisord-{self.machine}.log"

    def config_of(self, instance: str) -> Path:
        """Return the configuration file of a process."""
        return self.config_dir / f"{instance}.yaml"

    def log_of(self, instance: str) -> Path:
        """Return the newest log file of a process."""
        return self.log_dir / f"{instance}.log"


def check_paths(files: RunFiles) -> None:
    """Raise ConfigError when supervisord could not live with where this run or this checkout is."""
    length = len(str(files.socket))
    if length > SOCKET_PATH_LIMIT:
        raise ConfigError(
            [f"run_dir: {files.socket} has {length} characters, {SOCKET_PATH_LIMIT} are possible: shorten it"]
        )
    for path in (files.run_dir, REPOSITORY, Path(sys.executable)):
        if unwanted := set(str(path)) & set("%;\n"):
            raise ConfigError([f"{path}: supervisord cannot read {unwanted} in a path: rename the folder"])


def render(files: RunFiles, instances: Sequence[str]) -> str:
    """Write the supervisord.conf of the named processes of one machine."""
    head = (
        "[supervisord]",
        f"logfile={files.supervisor_log}",
        f"logfile_maxbytes={LOG_MB}MB",
        f"logfile_backups={LOG_BACKUPS}",
        f"pidfile={files.supervisor_log.with_suffix('.pid')}",
        "silent=true",
        "",
        "[unix_http_server]",
        f"file={files.socket}",
        "chmod=0700",
        "",
        "[rpcinterface:supervisor]",
        "supervisor.rpcinterface_factory=supervisor.rpcinterface:make_main_rpcinterface",
        "",
        "[supervisorctl]",
        f"serverurl=unix://{files.socket}",
    )
    return "\n".join((*head, *(line for name in instances for line in _program(files, name)), ""))


def _program(files: RunFiles, instance: str) -> tuple[str, ...]:
    process = process_of(instance)
    command = [sys.executable, "-m", process.module, "--config", str(files.config_of(instance))]
    environment = ",".join(
        f'{name}="{value}"' for name, value in {**THREADS, "PYTHONUNBUFFERED": "1"}.items()
    )
    return (
        "",
        f"[program:{instance}]",
        f"command={shlex.join(command)}",
        f"directory={REPOSITORY}",
        f"environment={environment}",
        f"priority={_priority(process)}",
        f"startsecs={process.warm_up_s}",
        f"startretries={START_RETRIES}",
        f"autorestart={'true' if process.autorestart == 'always' else 'unexpected'}",
        "exitcodes=0",
        "stopsignal=TERM",
        f"stopwaitsecs={STOP_WAIT_S}",
        "stopasgroup=true",
        "killasgroup=true",
        "redirect_stderr=true",
        f"stdout_logfile={files.log_of(instance)}",
        f"stdout_logfile_maxbytes={LOG_MB}MB",
        f"stdout_logfile_backups={LOG_BACKUPS}",
    )


def _priority(process: Process) -> int:
    return 10 * (1 + PROCESSES.index(process))

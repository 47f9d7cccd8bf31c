"""The command line of deploy/run_all.sh."""

from __future__ import annotations

from dataclasses import dataclass

COMMANDS = ("run", "up", "down", "status", "logs", "restart")
USAGE = """\
deploy/run_all.sh [MACHINE] [--config CELL] [--set a.b=c ...] [COMMAND]

  MACHINE             one machine of the cell; without it, all services on this machine
  --config CELL       a file, or a name in deploy/cells (default: reach)
  --set a.b=c         change one value of the cell; --a.b=c means the same

  run                 start, show progress, end when the run is finished (default); Ctrl-C ends it sooner
  up                  start in the background; returns when every service is healthy
  down                stop
  status              health of every service
  logs [SERVICE]      what the services print
  restart SERVICE     stop and start one service

A run that was stopped goes on where it was when it is started again."""


class UsageError(Exception):
    """A command line that cannot be understood; the text is one line for people."""


@dataclass(frozen=True)
class Arguments:
    """What the user asked for."""

    command: str = "run"
    machine: str | None = None
    cell: str = "reach"
    overrides: tuple[str, ...] = ()
    service: str | None = None
    help: bool = False


def parse(argv: list[str]) -> Arguments:
    """Read the command line. Raises UsageError."""
    words, options = _split(argv)
    command_at = next((i for i, word in enumerate(words) if word in COMMANDS), len(words))
    before, command, after = words[:command_at], words[command_at : command_at + 1], words[command_at + 1 :]
    if len(before) > 1:
        raise UsageError(f"{before[1]}: no such command; choose from {' '.join(COMMANDS)}")
    arguments = Arguments(
        command=command[0] if command else "run",
        machine=before[0] if before else None,
        cell=options.cell,
        overrides=tuple(options.overrides),
        service=after[0] if after else None,
        help=options.help,
    )
    _check_service(arguments, after)
    return arguments


def _check_service(arguments: Arguments, words: list[str]) -> None:
    allowed = 1 if arguments.command in ("logs", "restart") else 0
    if len(words) > allowed:
        raise UsageError(f"{words[allowed]}: one word too many after {arguments.command}")
    if arguments.command == "restart" and arguments.service is None:
        raise UsageError("restart: which service? `deploy/run_all.sh restart planner`")


@dataclass
class _Options:
    cell: str
    overrides: list[str]
    help: bool = False


def _split(argv: list[str]) -> tuple[list[str], _Options]:
    """Separate plain words from options."""
    words: list[str] = []
    options = _Options(Arguments.cell, [])
    rest = list(argv)
    while rest:
        word = rest.pop(0)
        name, equals, value = word.partition("=")
        if word in ("-h", "--help"):
            options.help = True
        elif name in ("--config", "--set"):
            _set(options, name, value if equals else _value(name, rest))
        elif word.startswith("--") and equals and "." in name:
            options.overrides.append(word.removeprefix("--"))
        elif word.startswith("-"):
            raise UsageError(f"{word}: no such option; `deploy/run_all.sh --help` lists them")
        else:
            words.append(word)
    return words, options


def _set(options: _Options, name: str, value: str) -> None:
    if name == "--config":
        options.cell = value
    else:
        options.overrides.append(value)


def _value(name: str, rest: list[str]) -> str:
    if not rest:
        raise UsageError(f"{name}: needs a value")
    return rest.pop(0)

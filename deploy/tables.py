"""`python -m deploy.tables [--check]`: rewrites the tables in README.md and docs/ that are made from code.

A table stands between `<!-- table:NAME -->` and `<!-- /table:NAME -->`; what is between them is replaced.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tomllib
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench.methods import METHODS
from common.task import TASKS, Task
from deploy.arguments import USAGE
from deploy.config_tables import cells, config, presets, sections
from deploy.confirm_tables import confirm
from deploy.markdown import Row, code, table
from deploy.pose_tables import pose_bands, pose_bars, pose_looks, pose_times
from deploy.processes import PROCESSES, Process
from deploy.supervisor import REPOSITORY
from deploy.topic_tables import messages, topics
from services.sim.gym_env import ENV_ID as DEXHAND_ENV_ID
from services.sim.plant import ENV_IDS

_MARKED = re.compile(r"<!-- table:(?P<name>[\w.:]+) -->\n(?P<body>.*?)<!-- /table:(?P=name) -->", re.DOTALL)
_LOOSE = re.compile(r"<!-- /?table:[\w.:]+ -->")


class TablesError(Exception):
    """A document that cannot be rewritten; the text is one line for people."""


# --- processes, contracts, commands ---------------------------------------------------------------


def processes() -> str:
    """One row per process, in order of start."""
    heads = (
        "process",
        "module",
        "kind",
        "needs",
        "stop wave",
        "healthy within",
        "if it exits",
        "if silent",
    )
    return table(heads, map(_process_row, PROCESSES))


def _process_row(process: Process) -> Row:
    always = process.autorestart == "always"
    return (
        f"{process.name}{'' if process.required else ' (optional)'}",
        code(process.module),
        process.kind,
        ", ".join(process.needs) or "–",
        str(process.stop_wave),
        f"{process.start_deadline_s:.0f} s",
        "restarted" if always else "restarted unless it has finished",
        "restarted" if process.watchdog_restarts else "left to people",
    )


def contracts() -> str:
    """One row per import contract of pyproject.toml."""
    data = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    rows = data["tool"]["importlinter"]["contracts"]
    return table(("contract", "modules", "must not import", "except"), map(_contract_row, rows))


def _contract_row(contract: Mapping[str, Any]) -> Row:
    modules = contract.get("source_modules") or contract["modules"]
    forbidden = contract.get("forbidden_modules", ["each other"])
    return contract["name"], *(
        ", ".join(map(code, x)) for x in (modules, forbidden, contract.get("ignore_imports", ()))
    )


def usage() -> str:
    """The help of deploy/run_all.sh."""
    return f"```text\n{USAGE}\n```\n"


def commands() -> str:
    """One row per module that people start, by the first sentence of its docstring."""
    started = {"deploy.main", *(process.module for process in PROCESSES)}  # the first behind run_all.sh
    found = sorted(
        path for part in ("deploy", "bench", "services") for path in (REPOSITORY / part).rglob("*.py")
    )
    return table(("command", "what it does"), (row for path in found for row in _command_rows(path, started)))


def _command_rows(path: Path, started: set[str]) -> list[Row]:
    text = path.read_text(encoding="utf-8")
    module = ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)
    if (
        '__name__ == "__main__"' not in text
        or re.search(r"^\s+run_process\(", text, re.M)
        or module in started
    ):
        return []
    about = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0]
    call = re.match(r"`(python -m [^`]+)`:\s*", about)
    about = about[call.end() :] if call else about
    about = about.partition("\n    python -m")[0].rstrip(": ")
    return [(code(call[1] if call else f"python -m {module}"), about[:1].upper() + about[1:])]


# --- tasks and methods ----------------------------------------------------------------------------


def tasks() -> str:
    """The simulated tasks: environment, sizes, state groups with their bounds of plausibility."""
    return table(
        ("task", "environment", "S", "A", "G", "state groups [first:end], unit"),
        map(_task_row, TASKS.values()),
    )


def _task_row(task: Task) -> Row:
    groups = "; ".join(f"{g.name} [{g.start}:{g.stop}], {g.unit}" for g in task.groups)
    return (
        task.name,
        code(ENV_IDS.get(task.name, DEXHAND_ENV_ID)),
        *map(str, (task.state_dim, task.action_dim, task.goal_dim)),
        groups,
    )


def methods() -> str:
    """What `bench.run --method` may be given."""
    rows = ((code(name), m.about, ", ".join(map(code, m.overrides)) or "–") for name, m in METHODS.items())
    return table(("method", "what it is", "differences from the cell"), rows)


# --- documents ------------------------------------------------------------------------------------

TABLES: Mapping[str, Callable[[], str]] = types.MappingProxyType(
    {
        each.__name__: each
        for each in (
            topics,
            messages,
            processes,
            contracts,
            usage,
            commands,
            presets,
            cells,
            tasks,
            methods,
            confirm,
            pose_bars,
            pose_bands,
            pose_looks,
            pose_times,
        )
    }
    | {f"config:{name}": lambda model=model: config(model) for name, model in sections().items()}
)


def documents() -> list[Path]:
    """The files that may hold tables."""
    return [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def rewritten(text: str, source: str) -> str:
    """Return a document with its tables as the code has them now. Raises TablesError."""
    unknown = [name for name, _ in _MARKED.findall(text) if name not in TABLES]
    if unknown:
        raise TablesError(f"{source}: no table {unknown[0]}; there are {', '.join(TABLES)}")
    if len(_LOOSE.findall(text)) != 2 * len(_MARKED.findall(text)):
        raise TablesError(f"{source}: a table's begin or end is missing")
    return _MARKED.sub(
        lambda m: f"<!-- table:{m['name']} -->\n{TABLES[m['name']]()}<!-- /table:{m['name']} -->", text
    )


def outdated() -> dict[Path, str]:
    """What the documents that are out of date should hold."""
    texts = {path: path.read_text(encoding="utf-8") for path in documents()}
    wanted = {path: rewritten(text, path.name) for path, text in texts.items()}
    return {path: text for path, text in wanted.items() if text != texts[path]}


def main(argv: list[str] | None = None) -> int:
    """Rewrite, or only look; 1 when something was or is out of date in a check, 2 for a broken document."""
    parser = argparse.ArgumentParser(
        prog="python -m deploy.tables", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--check", action="store_true", help="change nothing; 1 if a document is out of date")
    check = parser.parse_args(argv).check
    try:
        changed = outdated()
    except TablesError as error:
        print(error, file=sys.stderr)
        return 2
    for path, text in changed.items():
        print(f"{path.relative_to(REPOSITORY)}: {'out of date' if check else 'rewritten'}")
        if not check:
            path.write_text(text, encoding="utf-8")
    return int(check and bool(changed))


if __name__ == "__main__":
    sys.exit(main())

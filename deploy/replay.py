"""`python -m deploy.replay RUN_DIR SERVICE [--json]`: does this code still decide as the log says it did?"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from common.built import Built, codec_for
from common.buslog import Entry, log_files, read_log
from common.cell import SharedConfig
from common.config import ConfigError, load
from common.replay import Comparison, Replay, ReplayError, ReplayReport
from deploy.curriculum import build as build_curriculum
from deploy.curriculum_config import CurriculumProcess
from services.hand_io.build import build as build_hand_io
from services.hand_io.config import HandIoProcess
from services.learner.build import LearnerProcess
from services.learner.build import build as build_learner
from services.planner.build import PlannerProcess
from services.planner.build import build as build_planner
from services.sim.build import SimProcess
from services.sim.build import build as build_sim


@dataclass(frozen=True)
class Replayable:
    """A process that can be replayed; `remembers`: it also starts from what an earlier start left on disk."""

    config: type[SharedConfig]
    build: Callable[[Any, int], Built]
    remembers: bool = False


SERVICES: Mapping[str, Replayable] = MappingProxyType(
    {
        "sim": Replayable(SimProcess, build_sim),
        "hand_io": Replayable(HandIoProcess, build_hand_io),
        "planner": Replayable(PlannerProcess, build_planner),
        "learner": Replayable(LearnerProcess, build_learner, remembers=True),
        "curriculum": Replayable(CurriculumProcess, build_curriculum, remembers=True),
    }
)


@dataclass(frozen=True)
class Recording:
    """The log of one start of a process, in order; `birth` is False when the process had run before."""

    boot_id: int
    paths: tuple[Path, ...]
    birth: bool

    def entries(self) -> Iterator[Entry]:
        """Yield all entries."""
        return chain.from_iterable(read_log(path) for path in self.paths)


def main(argv: list[str] | None = None) -> int:
    """Print a verdict and the first differences. Exit code: 0 none, 1 some, 2 the log cannot be replayed."""
    options = _parser().parse_args(argv)
    ignored = Comparison(frozenset(options.ignore))
    try:
        recording = find_recording(options.run_dir, options.service, options.boot)
        report = replay_run(options.run_dir, options.service, recording, ignored)
    except (ReplayError, ConfigError) as error:
        print(f"{options.service}: {error}", file=sys.stderr)
        return 2
    print(
        _as_json(options.service, recording, report) if options.json else "\n".join(_lines(recording, report))
    )
    return 1 if report.differing else 0


def find_recording(run_dir: Path, name: str, boot_id: int | None = None) -> Recording:
    """Return the log of the newest start of a process, or of the one named. Raises ReplayError."""
    starts: dict[int, list[Path]] = {}
    for path in log_files(run_dir / "log", name):
        if not path.stat().st_size:
            continue  # begun, but nothing has been handed to the system yet
        starts.setdefault(int(path.stem.rsplit("-", 2)[1]), []).append(path)
    if not starts:
        raise ReplayError(f"no log of it in {run_dir / 'log'}")
    boot_id = list(starts)[-1] if boot_id is None else boot_id
    if boot_id not in starts:
        raise ReplayError(f"no start {boot_id}; there are {', '.join(map(str, starts))}")
    paths = starts[boot_id]
    if not paths[0].stem.endswith("-0000"):
        raise ReplayError("the beginning of this log was deleted to keep within log.keep_mb")
    return Recording(boot_id, tuple(paths), birth=boot_id == next(iter(starts)))


def replay_run(run_dir: Path, name: str, recording: Recording, comparison: Comparison) -> ReplayReport:
    """Replay a recording with the configuration of its run; writes nothing into the run."""
    row = SERVICES[name]
    with tempfile.TemporaryDirectory(prefix="replay-") as scratch:
        config = load(row.config, run_dir / "config" / f"{name}.yaml")
        config = config.model_copy(update={"run_dir": Path(scratch)})
        built = row.build(config, recording.boot_id)
        report = Replay(built.service, codec_for(config.task), comparison).run(recording.entries())
    if row.remembers and not recording.birth:
        print(
            f"{name} had run before: what it found on disk is not in this log, so it differs", file=sys.stderr
        )
    return report


def _lines(recording: Recording, report: ReplayReport) -> Iterator[str]:
    verdict = f"{report.differing} differences" if report.differing else "no difference"
    yield f"start {recording.boot_id}: {report.steps} steps, {report.frames} frames compared: {verdict}"
    yield from map(str, report.differences)


def _as_json(name: str, recording: Recording, report: ReplayReport) -> str:
    about = {"service": name, "boot_id": recording.boot_id, "birth": recording.birth}
    return json.dumps(about | dataclasses.asdict(report), indent=2)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy.replay", description=__doc__)
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("service", choices=tuple(SERVICES))
    parser.add_argument("--boot", type=int, help="which start of the process; default: the newest")
    parser.add_argument("--ignore", action="append", default=[], metavar="FIELD", help="do not compare it")
    parser.add_argument("--json", action="store_true")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""`python -m deploy.record to-rrd RUN_DIR [-o FILE]`: merge the processes' bus logs into one recording."""

from __future__ import annotations

import argparse
import heapq
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common.built import codec_for
from common.buslog import Entry, log_files, read_log
from common.cell import SharedConfig
from common.codec import Codec, Refused
from common.config import ConfigError, parse, read_yaml
from common.messages import Sample
from common.topics import topic_of
from deploy.viewer.dashboard import Pages, arrange
from deploy.viewer.drawer import DRAWN, Drawer
from deploy.viewer.recording import Recording, file_sink
from services.sim.kinematics import SceneKinematics

BATCH = 20_000  # drawings
FLUSH_S = 60.0


@dataclass
class Tally:
    """What a conversion met."""

    drawn: int = 0
    refused: int = 0


def to_rrd(run_dir: Path, output: Path) -> Tally:
    """Write the dashboard of a run's logs to `output`. Raises ConfigError if there is nothing to read."""
    shared = read_shared(run_dir)
    files = log_files(run_dir / "log")
    if not files:
        raise ConfigError([f"{run_dir / 'log'}: holds no bus logs"])
    tally = Tally()
    recording = Recording(run_dir.name, file_sink(output), BATCH)
    kinematics = SceneKinematics(shared.task)
    driven = (run_dir / "config" / "hand_io.yaml").exists()
    watched = (run_dir / "config" / "perception.yaml").exists()
    arrange(recording, kinematics, shared, ghost=True, pages=Pages(driven, watched))
    drawer = Drawer(kinematics, shared.control.period_ns, ghost=True)
    for sample in unique_samples(merged(files), codec_for(shared.task), tally):
        recording.add(drawer.draw(sample))
    recording.close(FLUSH_S)
    return tally


def read_shared(run_dir: Path) -> SharedConfig:
    """What all processes of the run were told. Raises ConfigError without a rendered configuration."""
    for path in sorted((run_dir / "config").glob("*.yaml")):
        data = read_yaml(path)
        if "task" in data:
            known = {name: data[name] for name in SharedConfig.model_fields if name in data}
            return parse(SharedConfig, known | {"run_dir": run_dir}, source=path.name)
    raise ConfigError([f"{run_dir / 'config'}: holds no configuration of a process"])


def merged(files: list[Path]) -> Iterator[Entry]:
    """Entries of all files in the order of their times."""
    return heapq.merge(*(read_log(path) for path in files), key=lambda entry: entry.t_ns)


def unique_samples(entries: Iterator[Entry], codec: Codec, tally: Tally) -> Iterator[Sample]:
    """Each drawn message once: the sender and every receiver have logged it."""
    seen: set[tuple[str, int, int]] = set()
    for entry in entries:
        if entry.kind not in ("in", "out") or not _is_drawn(entry.key):
            continue
        try:
            sample = codec.decode(entry.key, entry.payload)
        except Refused:
            tally.refused += 1
            continue
        name = (sample.key, sample.header.boot_id, sample.header.seq)
        if name not in seen:
            seen.add(name)
            tally.drawn += 1
            yield sample


def _is_drawn(key: str) -> bool:
    try:
        return topic_of(key) in DRAWN
    except KeyError:  # the log of a newer version
        return False


def main(arguments: list[str] | None = None) -> int:
    """Convert; return 0, or 2 after one line about what is wrong."""
    options = _parser().parse_args(arguments)
    run_dir: Path = options.run_dir
    output: Path = options.output or run_dir / "log.rrd"
    try:
        tally = to_rrd(run_dir, output)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{output}: {tally.drawn} messages, {tally.refused} refused; see it with: rerun {output}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy.record", description="Recordings of a run.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    convert = commands.add_parser("to-rrd", help="merge the bus logs of a run into one Rerun recording")
    convert.add_argument("run_dir", type=Path, metavar="RUN_DIR")
    convert.add_argument("-o", "--output", type=Path, metavar="FILE", help="default: RUN_DIR/log.rrd")
    return parser


if __name__ == "__main__":
    sys.exit(main())

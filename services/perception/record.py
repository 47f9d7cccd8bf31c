"""`python -m services.perception.record SOURCE FOLDER`: keeps what a camera sees as a recording of ours.

A camera that gives no frame for PATIENCE_S ends it, as does Ctrl-C; what has been written by then plays.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections import Counter
from pathlib import Path

from common.config import ConfigError
from services.perception.frames import Frame, FrameSource, Refusal
from services.perception.recording import Recorder
from services.perception.sources import source_at

PATIENCE_S = 5.0
_REPORT_EVERY = 30  # frames


def record(source: FrameSource, recorder: Recorder, most: int, counts: Counter[str]) -> None:
    """Write at most so many frames, and count them and those that were refused, by reason."""
    while counts["frames"] < most:
        read = source.read(PATIENCE_S)
        if isinstance(read, Frame):
            recorder.write(read)
            counts["frames"] += 1
            if counts["frames"] % _REPORT_EVERY == 0:
                print(f"{counts['frames']} frames", flush=True)
            continue
        if read.reason is not Refusal.ENDED:
            counts[read.reason.value] += 1
            print(read.message, file=sys.stderr)
        if read.reason in (Refusal.ENDED, Refusal.TIMEOUT):
            break


def main(arguments: list[str] | None = None) -> int:
    """Record; 0: done, 1: there was no frame, 2: source or folder cannot be used."""
    options = _parser().parse_args(arguments)
    try:
        counts = _recorded(options.source, options.folder, options.frames)
    except (ConfigError, ImportError, OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    refused = ", ".join(
        f"{count} refused: {reason}" for reason, count in counts.items() if reason != "frames"
    )
    print(f"{options.folder}: {counts['frames']} frames{f', {refused}' if refused else ''}")
    return 0 if counts["frames"] else 1


def _recorded(path: Path, folder: Path, most: int) -> Counter[str]:
    source = source_at(path)
    counts: Counter[str] = Counter()
    with (
        contextlib.closing(source),
        contextlib.closing(Recorder(folder)) as recorder,
        contextlib.suppress(KeyboardInterrupt),
    ):
        record(source, recorder, most, counts)
    return counts


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="services.perception.record", description=__doc__)
    parser.add_argument("source", type=Path, help="a camera's YAML (kind: realsense), a .bag, or a recording")
    parser.add_argument("folder", type=Path, help="a new folder, 0.7 MB a frame")
    parser.add_argument("--frames", type=int, default=600, help="at most")
    return parser


if __name__ == "__main__":
    sys.exit(main())

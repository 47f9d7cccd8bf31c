"""`python -m deploy.viewer.screenshot RECORDING.rrd PICTURE.png [--step K|--time T]`: the dashboard drawn.

Needs no display, but a Vulkan driver; Mesa's software one will do (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import argparse
import socket
import sys
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import rerun_cli
from rerun.experimental import ViewerClient

LOAD_S = 5.0  # until a recording is loaded and its plots are laid out
PAINT_S = 2.0


def screenshot(recording: Path, picture: Path, moment: Mapping[str, Any]) -> None:
    """Show `recording` at a moment (none: its end) in a viewer without a window and save what it shows."""
    program = str(Path(rerun_cli.__file__).with_name("rerun"))
    with ViewerClient.spawn(
        headless=True, port=_free_port(), hide_welcome_screen=True, executable_path=program
    ) as viewer:
        viewer.open(str(recording.resolve()))
        time.sleep(LOAD_S)
        if moment:
            viewer.set_time(**moment, play_state="paused")
            time.sleep(PAINT_S)
        picture.write_bytes(viewer.take_screenshot())


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def main(arguments: list[str] | None = None) -> int:
    """Take the picture; return 0, or 2 after one line about what is wrong."""
    parser = argparse.ArgumentParser(prog="python -m deploy.viewer.screenshot")
    parser.add_argument("recording", type=Path, metavar="RECORDING.rrd")
    parser.add_argument("picture", type=Path, metavar="PICTURE.png")
    when = parser.add_mutually_exclusive_group()
    when.add_argument("--step", type=int, help="control step to show; default: the end of the recording")
    when.add_argument("--time", type=datetime.fromisoformat, help="UTC, as 2026-01-31T12:00:00, instead")
    options = parser.parse_args(arguments)
    if not options.recording.is_file():
        print(f"{options.recording}: no such recording", file=sys.stderr)
        return 2
    screenshot(options.recording, options.picture, _moment(options.step, options.time))
    return 0


def _moment(step: int | None, time_utc: datetime | None) -> dict[str, Any]:
    if step is not None:
        return {"timeline": "step", "sequence": step}
    if time_utc is not None:
        return {"timeline": "time", "timestamp": time_utc.replace(tzinfo=UTC)}
    return {}


if __name__ == "__main__":
    sys.exit(main())

"""`python -m deploy.viewer.screenshot RECORDING.rrd PICTURE.png [--step K]`: the dashboard as a picture.

Needs no display, but a Vulkan driver; Mesa's software one will do (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import argparse
import socket
import sys
import time
from pathlib import Path

import rerun_cli
from rerun.experimental import ViewerClient

LOAD_S = 5.0  # until a recording is loaded and its plots are laid out
PAINT_S = 2.0


def screenshot(recording: Path, picture: Path, step: int | None) -> None:
    """Show `recording` at `step` (None: its end) in a viewer without a window and save what it shows."""
    program = str(Path(rerun_cli.__file__).with_name("rerun"))
    with ViewerClient.spawn(
        headless=True, port=_free_port(), hide_welcome_screen=True, executable_path=program
    ) as viewer:
        viewer.open(str(recording.resolve()))
        time.sleep(LOAD_S)
        if step is not None:
            viewer.set_time("step", sequence=step, play_state="paused")
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
    parser.add_argument("--step", type=int, help="control step to show; default: the last")
    options = parser.parse_args(arguments)
    if not options.recording.is_file():
        print(f"{options.recording}: no such recording", file=sys.stderr)
        return 2
    screenshot(options.recording, options.picture, options.step)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""`python -m services.perception.calibrate plate|capture|solve|verify`: where the camera is to the palm.

`capture` keeps good views of the plate as a recording, `solve` makes a calibration file of it, `verify` tells
whether that still holds. A rig file describes plate, jig and tag: docs/guides/perception.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2

from common.config import ConfigError, load
from services.perception.calibration import Calibration
from services.perception.capture import POSES, TIMEOUT_S, Capture, CaptureError, read_poses
from services.perception.fit import fit, read_views
from services.perception.frames import Frame
from services.perception.plate import Plate
from services.perception.recording import Player
from services.perception.rig import RigConfig
from services.perception.solve import SolveError
from services.perception.sources import source_at
from services.perception.verify import drawn, verify

PRINT_DPI = 600
INCH_M = 0.0254


def main(arguments: list[str] | None = None) -> int:
    """Carry out one command; 0: done, 1: the calibration does not hold, 2: it could not be done."""
    options = _parser().parse_args(arguments)
    try:
        return options.command(options, load(RigConfig, options.rig))
    except (ConfigError, CaptureError, SolveError, ValueError, OSError, RuntimeError, ImportError) as error:
        print(error, file=sys.stderr)
        return 2


def _plate(options: argparse.Namespace, rig: RigConfig) -> int:
    picture = Plate(rig.plate).picture(PRINT_DPI / INCH_M)
    _write(options.picture, picture)
    print(f"{options.picture}: print it at {PRINT_DPI} dpi without scaling, and measure a square")
    return 0


def _capture(options: argparse.Namespace, rig: RigConfig) -> int:
    poses = read_poses(options.poses) if options.poses else None
    source = source_at(options.source)
    try:
        Capture(rig, source, options.folder, print).run(poses, _wait)
    finally:
        source.close()
    return 0


def _wait(text: str) -> None:
    input(f"{text}; then press Return ")


def _solve(options: argparse.Namespace, rig: RigConfig) -> int:
    views = read_views(Player(options.folder), rig)
    for line in views.refused:
        print(line)
    arm = [] if options.case == "jig" else read_poses(options.folder / POSES)
    calibration = fit(rig, views, options.case, arm, Player(options.tag_frames or options.folder))
    calibration.save(options.out)
    left = calibration.residuals
    fits = f"{left.pixels_rms:.2f} px, {left.position_mm:.2f} mm, {left.rotation_deg:.2f} deg"
    print(f"{options.out}: {left.views} views, {fits}")
    if calibration.tag is None:
        print("no palm tag seen: nobody will notice a knocked camera")
    return 0


def _verify(options: argparse.Namespace, rig: RigConfig) -> int:
    calibration = load(Calibration, options.calibration)
    source = source_at(options.source)
    try:
        frame = source.read(TIMEOUT_S)
    finally:
        source.close()
    if not isinstance(frame, Frame):
        raise ValueError(frame.message)
    findings = verify(rig, calibration, frame)
    for finding in findings:
        print(finding)
    if options.picture:
        _write(options.picture, cv2.cvtColor(drawn(calibration, frame), cv2.COLOR_RGB2BGR))
    return int(not all(finding.ok for finding in findings))


def _write(path: Path, picture: cv2.typing.MatLike) -> None:
    if not cv2.imwrite(str(path), picture):
        raise OSError(f"{path}: cannot be written")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m services.perception.calibrate")
    commands = parser.add_subparsers(required=True, metavar="plate|capture|solve|verify")

    def command(name: str, function: object, about: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=about, description=about)
        added.set_defaults(command=function)
        added.add_argument("rig", type=Path, metavar="RIG.yaml")
        return added

    plate = command("plate", _plate, "draw the plate, to be printed")
    plate.add_argument("picture", type=Path, metavar="PLATE.png")
    capture = command("capture", _capture, "keep good views of the plate")
    capture.add_argument("source", type=Path, help="YAML of a camera, or a folder with a recording")
    capture.add_argument("folder", type=Path, help="where the views go")
    capture.add_argument(
        "--poses", type=Path, help="of the palm in the arm's base, a line each: x y z w x y z"
    )
    solve = command("solve", _solve, "make a calibration file of views")
    solve.add_argument("folder", type=Path, help="with the views")
    solve.add_argument("--case", choices=("jig", "hand_eye", "robot_world"), default="jig")
    solve.add_argument("--tag-frames", type=Path, help="another recording, that shows the palm's tag")
    solve.add_argument("--out", type=Path, default=Path("calibration.yaml"))
    check = command("verify", _verify, "tell whether a calibration still holds")
    check.add_argument("calibration", type=Path, metavar="CALIBRATION.yaml")
    check.add_argument("source", type=Path, help="YAML of a camera, or a folder with a recording")
    check.add_argument("--picture", type=Path, help="PNG to draw the palm's axes and the tag's place into")
    return parser


if __name__ == "__main__":
    sys.exit(main())

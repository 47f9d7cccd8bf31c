"""`python -m deploy.glove make|fit|check`: data glove recordings for the warm-up (docs/guides/glove.md).

`make` shows demonstrations on the twin, as recordings of a made-up person; `fit` finds a person's affine fit
from recordings of held postures; `check` reads recordings as a cell would and says what they hold.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml
from rich.progress import track

from common.config import ConfigError
from common.dexhand021.glove_config import GloveConfig, GloveSource
from common.dexhand021.glove_files import SUFFIXES, read_actions, read_recordings
from common.dexhand021.glove_fit import POSTURES, fit
from common.dexhand021.glove_recording import DEGREES_PER_UNIT, GloveError, Recording
from common.dexhand021.tables import HIGH_RAD, JOINTS
from deploy.cell import load_cell
from services.sim.glove_demonstrator import Demonstrator
from services.sim.glove_person import Person
from services.sim.glove_writers import FORMATS, write_recordings

POSTURES_FOLDER = "postures"
HELD_STEPS = 4  # of a posture


# --- make -----------------------------------------------------------------------------------------


def make(options: argparse.Namespace) -> None:
    """Write demonstrations and held postures of one made-up person."""
    rng = np.random.default_rng(options.seed)
    person = Person() if options.exact else Person.drawn(rng)
    demonstrator = Demonstrator(options.candidates, options.rate)
    recordings: list[Recording] = []
    turned: list[float] = []
    takes = 0
    for number in track(range(options.demonstrations), "demonstrations", disable=not sys.stderr.isatty()):
        shown = demonstrator.demonstrate(options.seed + 1000 * number, options.steps)
        recordings.append(person.record(shown.postures_rad, options.rate, rng, f"demonstration_{number:03d}"))
        turned.append(shown.turned_rad)
        takes += shown.takes
    written = write_recordings(options.folder, recordings, options.format)
    held = "csv" if options.format == "lerobot" else options.format
    write_recordings(options.folder / POSTURES_FOLDER, held_postures(person, options.rate, rng), held)
    print(
        f"{len(written)} {options.format} in {options.folder}: {len(recordings)} demonstrations, "
        f"{len(recordings) * options.steps} actions at {options.rate:g} Hz; the die came "
        f"{np.mean(turned):.2f} rad nearer to its goal in the mean, "
        f"{takes - len(recordings)} takes thrown away"
    )


def held_postures(person: Person, rate_hz: float, rng: np.random.Generator) -> list[Recording]:
    """A recording of each posture that `fit` wants, held for a second or so."""
    recordings: list[Recording] = []
    for name, shares in POSTURES.items():
        posture = np.array([shares.get(joint.name, 0.0) for joint in JOINTS]) * HIGH_RAD
        recordings.append(person.record(np.tile(posture, (HELD_STEPS, 1)), rate_hz, rng, name))
    return recordings


# --- fit ------------------------------------------------------------------------------------------


def fit_person(options: argparse.Namespace) -> None:
    """Write the fit of the person whose postures lie in a folder."""
    config = GloveConfig(unit=options.unit)
    recordings = {name: _posture(options.folder, name, config) for name in POSTURES}
    found = fit(recordings)
    text = yaml.safe_dump(found.user.model_dump(mode="json"), sort_keys=False, default_flow_style=None)
    options.out.write_text(
        f"# Written by python -m deploy.glove fit {options.folder}\n{text}", encoding="utf-8"
    )
    print(f"{'motor':8}{'gain':>8}{'offset':>10}{'misses a posture by':>22}")
    for motor, joint in enumerate(JOINTS):
        gain, offset = found.user.gain[motor], found.user.offset_deg[motor]
        print(f"{joint.name:8}{gain:8.3f}{offset:8.1f} °{found.miss_deg[motor]:20.1f} °")
    print(f"th_rot per Thumb_CMC_Spread: {found.user.thumb_spread_gain:.3f}; written to {options.out}")


def _posture(folder: Path, name: str, config: GloveConfig) -> Recording:
    for suffix in SUFFIXES:
        path = folder / f"{name}{suffix}"
        if path.is_file():
            return read_recordings(path, config)[0]
    raise GloveError(f"{folder}: there is no recording of the posture {name} ({name}.csv, ...)")


# --- check ----------------------------------------------------------------------------------------


def check(options: argparse.Namespace) -> None:
    """Say what recordings hold, and how much of it the hand cannot reach."""
    config, rate_hz = _checked_config(options)
    total = 0
    for each in read_actions(config, rate_hz):
        total += len(each.actions)
        worst = int(np.argmax(each.cut))
        cut = f"; beyond reach: {JOINTS[worst].name} in {each.cut[worst]:.0%}" if each.cut.any() else ""
        print(f"{each.source}: {len(each.actions)} actions at {rate_hz:g} Hz{cut}")
    print(f"in all: {total} actions")


def _checked_config(options: argparse.Namespace) -> tuple[GloveConfig, float]:
    if options.cell:
        cell = load_cell(options.cell, options.overrides)
        if not cell.glove.sources:
            raise ConfigError([f"{options.cell}: has no recordings (glove.sources)"])
        return cell.glove, cell.control.rate_hz
    if not options.files:
        raise ConfigError(["check: name recordings, or a cell with --cell"])
    source = GloveSource(files=tuple(options.files), user=options.user)
    return GloveConfig(sources=(source,), unit=options.unit), options.rate


# --- command line ---------------------------------------------------------------------------------


def main(argv: Sequence[str] | None = None) -> int:
    """Do what the command line says; 1 after one line about a recording that cannot be used."""
    options = _parser().parse_args(argv)
    try:
        options.action(options)
    except (ConfigError, OSError, RuntimeError, ValueError) as error:
        print(f"glove: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m deploy.glove", description=(__doc__ or "").partition("\n")[0]
    )
    actions = parser.add_subparsers(required=True, metavar="make|fit|check")
    _add_make(actions.add_parser("make", help="show demonstrations on the twin"))
    fitting = actions.add_parser("fit", help="a person's affine fit, from held postures")
    fitting.add_argument("folder", type=Path, help=f"recordings named {', '.join(POSTURES)}")
    fitting.add_argument("--out", type=Path, required=True, help="file that glove.sources names as user")
    fitting.add_argument("--unit", choices=tuple(DEGREES_PER_UNIT), default="deg", help="of the angles")
    fitting.set_defaults(action=fit_person)
    checking = actions.add_parser("check", help="read recordings as a cell would")
    checking.add_argument("files", nargs="*", help="files, patterns or LeRobot folders")
    checking.add_argument("--user", type=Path, help="the person's fit")
    checking.add_argument("--unit", choices=("auto", *DEGREES_PER_UNIT), default="auto")
    checking.add_argument("--rate", type=float, default=3.0, help="control rate, Hz")
    checking.add_argument("--cell", help="those of a cell instead")
    checking.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    checking.set_defaults(action=check)
    return parser


def _add_make(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, help="where to write")
    parser.add_argument("--format", choices=FORMATS, default="csv")
    parser.add_argument("--demonstrations", type=int, default=80, help="80 of 50 steps are the paper's 4000")
    parser.add_argument("--steps", type=int, default=50, help="actions of each")
    parser.add_argument("--rate", type=float, default=3.0, help="control rate, Hz")
    parser.add_argument("--candidates", type=int, default=16, help="movements tried before each is made")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--exact", action="store_true", help="a glove without noise that needs no fit")
    parser.set_defaults(action=make)


if __name__ == "__main__":
    sys.exit(main())

"""`python -m services.perception.onboard --source RECORDING --size-mm 60 --out die.yaml`: learns a new die.

Lay the die into the open hand, a face towards the camera, and turn it to another one now and then. Colours,
polarity, pip radius and spacing are fitted. Corner radius, and which way round pips lie, are for a person.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from common.config import ConfigError
from common.die import DIE, Die, Rgb
from common.die_file import write_die
from services.perception.face_fit import FaceFit, fit_face
from services.perception.frames import FrameSource, Refusal, Refused
from services.perception.sources import source_at

_PATIENCE = 50  # frames without a face


class OnboardError(Exception):
    """Too little was seen of the die; says what to do."""


def combine(faces: Sequence[FaceFit], size_m: float, corner_radius_m: float) -> Die:
    """The die that the faces show, by medians. Raises OnboardError if they show too little."""
    spacings = [face.pip_spacing_m for face in faces if face.pip_spacing_m is not None]
    if not spacings:
        raise OnboardError("only faces with one pip were seen: show another one too")
    return replace(
        DIE,
        size_m=size_m,
        corner_radius_m=corner_radius_m,
        mass_kg=DIE.mass_kg * (size_m / DIE.size_m) ** 3,
        pip_radius_m=round(float(np.median([face.pip_radius_m for face in faces])), 5),
        pip_spacing_m=round(float(np.median(spacings)), 5),
        body_rgb=_median([face.body_rgb for face in faces]),
        pip_rgb=_median([face.pip_rgb for face in faces]),
    )


def main(arguments: list[str] | None = None) -> int:
    """Fit and write; 0: done, 1: too little was seen, 2: the source cannot be read."""
    options = _parser().parse_args(arguments)
    try:
        source = source_at(options.source)
        try:
            faces = _watch(source, options.size_mm / 1e3, options.faces)
        finally:
            source.close()
        die = combine(faces, options.size_mm / 1e3, options.corner_mm / 1e3)
    except OnboardError as error:
        print(error, file=sys.stderr)
        return 1
    except (ConfigError, ImportError, OSError, RuntimeError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    write_die(options.out, die)
    polarity = "light pips on a dark body" if die.light_pips else "dark pips on a light body"
    print(f"{options.out}: {polarity}, radius {1e3 * die.pip_radius_m:.1f} mm, from {len(faces)} views")
    return 0


def _watch(source: FrameSource, size_m: float, wanted: int) -> list[FaceFit]:
    """Faces of as many frames as wanted. Raises OnboardError where none is to be seen."""
    faces: list[FaceFit] = []
    without = 0
    while len(faces) < wanted:
        frame = source.read(1.0)
        if isinstance(frame, Refused):
            if frame.reason is Refusal.ENDED and faces:
                break
            found = frame.message
        else:
            found = fit_face(frame, size_m)
        if isinstance(found, FaceFit):
            faces.append(found)
            print(f"face {found.pips}")
            continue
        without += 1
        if without > _PATIENCE or (isinstance(frame, Refused) and frame.reason is Refusal.ENDED):
            raise OnboardError(f"{found} ({without} frames without a face)")
    return faces


def _median(colours: Sequence[Rgb]) -> Rgb:
    red, green, blue = (int(level) for level in np.median(np.array(colours), axis=0))
    return red, green, blue


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="services.perception.onboard", description=__doc__)
    parser.add_argument("--source", type=Path, required=True, help="a recording, or a source's YAML")
    parser.add_argument("--out", type=Path, required=True, help="YAML file to write")
    parser.add_argument("--size-mm", type=float, required=True, help="edge of the die, measured")
    parser.add_argument("--corner-mm", type=float, default=1e3 * DIE.corner_radius_m, help="radius of edges")
    parser.add_argument("--faces", type=int, default=30, help="views to take")
    return parser


if __name__ == "__main__":
    sys.exit(main())

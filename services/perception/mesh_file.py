"""`python -m services.perception.mesh_file OUT.obj`: the die as a textured mesh, for backends that want one.

Metres, centred, the frame of common.die: what FoundationPose takes as `mesh`. A mesh in millimetres is the
most frequent mistake made with it; SAM-6D wants just that (`--millimetres`).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals

from common.config import ConfigError
from common.dice import APPEARANCES
from common.die import Die
from common.die_file import read_die

_TEXTURE_PX = 128  # of a face's side


def textured_mesh(die: Die, scale: float = 1.0) -> trimesh.Trimesh:
    """The die's rounded surface with its pips as a picture; `scale` times metres."""
    mesh = die.mesh()
    picture = Image.fromarray(die.atlas(_TEXTURE_PX))
    # The die counts v from the picture's upper edge, trimesh and OBJ from the lower one.
    uv = np.column_stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]])
    visual = TextureVisuals(uv=uv, image=picture)
    return trimesh.Trimesh(scale * mesh.vertices, mesh.triangles, visual=visual, process=False)


def main(arguments: list[str] | None = None) -> int:
    """Write mesh, material and picture; 0: done, 2: the die or the file cannot be."""
    parser = argparse.ArgumentParser(prog="services.perception.mesh_file", description=__doc__)
    parser.add_argument("out", type=Path, help="file to write, by its ending .obj, .ply or .glb")
    parser.add_argument("--die", default="white", help="a name of common.dice, or a YAML file of onboard")
    parser.add_argument("--millimetres", action="store_true", help="for SAM-6D")
    options = parser.parse_args(arguments)
    try:
        known = APPEARANCES.get(options.die)
        die = known.die if known else read_die(Path(options.die))
        textured_mesh(die, 1e3 if options.millimetres else 1.0).export(options.out)
    except (ConfigError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{options.out}: {1e3 * die.size_m:.0f} mm die")
    return 0


if __name__ == "__main__":
    sys.exit(main())

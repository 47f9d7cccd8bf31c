"""Dice that a laboratory may have on its shelf: what the tracker knows of each, and how its surface looks."""

from __future__ import annotations

from dataclasses import dataclass

from common.die import DIE, Die


@dataclass(frozen=True)
class Appearance:
    """A die and its finish. Perception knows `die` alone; a simulated camera draws the rest as well."""

    die: Die
    specular: float = 0.3  # strength and sharpness of highlights, as MuJoCo's materials
    shininess: float = 0.3
    opacity: float = 1.0  # below 1 the background shines through, and depth is read within the body
    wear: float = 0.0  # 0 new .. 1: paint gone from pips in patches, scuffed and stained body


APPEARANCES: dict[str, Appearance] = {
    "white": Appearance(DIE),
    "black": Appearance(Die(body_rgb=(34, 34, 37), pip_rgb=(235, 235, 230)), specular=0.5, shininess=0.5),
    "red": Appearance(Die(body_rgb=(176, 28, 34), pip_rgb=(240, 238, 232), quarters=(0, 1, 1, 0, 0, 1))),
    "translucent": Appearance(
        Die(body_rgb=(120, 150, 185), pip_rgb=(238, 240, 242), corner_radius_m=0.006),
        specular=0.9,
        shininess=0.9,
        opacity=0.75,
    ),
    "worn": Appearance(
        Die(body_rgb=(208, 198, 176), pip_rgb=(62, 58, 54), corner_radius_m=0.007), specular=0.1, wear=0.6
    ),
}

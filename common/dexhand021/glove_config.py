"""The glove's section of a cell: whose recordings the warm-up replays, and how they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator

from common.config import Frozen
from common.dexhand021.config import Confirm
from common.dexhand021.glove_recording import COLUMNS, TIME_COLUMNS, Unit
from common.dexhand021.tables import MOTORS

Gain = Annotated[float, Field(ge=-50.0, le=50.0)]
OffsetDeg = Annotated[float, Field(ge=-3600.0, le=3600.0)]


class GloveUser(Frozen):
    """Affine fit of one person in one glove: motor angle = gain · mapped angle + offset, order of JOINTS.

    A file of its own, written by `python -m deploy.glove fit`.
    """

    gain: tuple[Gain, ...] = Field(
        default=(1.0,) * MOTORS, min_length=MOTORS, max_length=MOTORS, description="motor per glove angle"
    )
    offset_deg: tuple[OffsetDeg, ...] = Field(
        default=(0.0,) * MOTORS, min_length=MOTORS, max_length=MOTORS, description="motor angle at glove's 0"
    )
    thumb_spread_gain: Gain = Field(default=1.0, description="th_rot per Thumb_CMC_Spread, added to its own")


class GloveSource(Frozen):
    """One person's recordings."""

    files: tuple[str, ...] = Field(
        min_length=1, description="files, patterns (`*.csv`) or LeRobot folders, from the project's folder"
    )
    user: Path | None = Field(default=None, description="that person's fit; null: the documented map alone")


class GloveConfig(Frozen):
    """Recordings for `curriculum.warmup: glove`."""

    sources: tuple[GloveSource, ...] = Field(default=(), description="whose recordings; none: no glove")
    unit: Unit = Field(
        default="auto", description="of the angles; auto: as the file says, else deg if that can be"
    )
    max_gap_s: float = Field(default=0.2, gt=0.0, le=2.0, description="a longer gap refuses the recording")
    names: dict[str, str] = Field(default={}, description="what your glove calls a column, if not as Manus")
    topic: str = Field(default="", description="of an MCAP file; empty: the only one with a glove")

    @field_validator("names")
    @classmethod
    def _known(cls, names: dict[str, str]) -> dict[str, str]:
        for name in names:
            if name not in (*COLUMNS, *TIME_COLUMNS):
                raise ValueError(f"{name} is no column; there are {', '.join((*TIME_COLUMNS, *COLUMNS))}")
        return names

    def within(self, folder: Path) -> GloveConfig:
        """The same with relative paths meant from `folder`."""
        sources = [
            GloveSource(
                files=tuple(str(folder / file) for file in source.files),
                user=None if source.user is None else folder / source.user,
            )
            for source in self.sources
        ]
        return self.model_copy(update={"sources": tuple(sources)})

    def without_places(self) -> GloveConfig:
        """The same with the names of files alone, as far as a digest is concerned with them."""
        sources = [
            GloveSource(
                files=tuple(Path(file).name for file in source.files),
                user=None if source.user is None else Path(source.user.name),
            )
            for source in self.sources
        ]
        return self.model_copy(update={"sources": tuple(sources)})


CONFIRM_ON_HARDWARE = (
    Confirm(
        "unit",
        "auto",
        "the paper's glove is not public, and the Manus export names no unit: degrees unless that cannot be",
        "bend one finger of the glove to a right angle and read its column",
    ),
    Confirm(
        "names",
        "{}",
        "names are those of Manus, flexion is positive, and the thumb's PIP and DIP are its MCP and IP",
        "move one joint of the glove after another and see which column changes, and which way",
    ),
    Confirm(
        "sources",
        "()",
        "a person without a fit has gain 1 and offset 0; how far a glove reads a hand true is not public",
        "`python -m deploy.glove fit` over six postures; `check` says which motors are cut",
    ),
    Confirm(
        "",
        "twenty angles become twelve motors by the map of docs/guides/glove.md (common/dexhand021/glove.py)",
        "no map is published: mean of PIP and DIP, mean spread of three fingers, thumb rotation from its CMC",
        "replay a recording on the twin (`curriculum.warmup=glove`), then on the hand at the lowest current",
    ),
)

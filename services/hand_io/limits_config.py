"""Options of the last gate before the wire."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from common.config import Frozen
from common.dexhand021.config import Confirm
from common.dexhand021.tables import FINGER_PITCH_M, FINGER_RADIUS_M, MAX_CURRENT


class LimitsConfig(Frozen):
    """How far, fast and hard the motors may go; the range itself is the hand's, in tables.py."""

    rate_rad_s: float = Field(default=1.5, gt=0.0, le=10.0, description="fastest change of a set point")
    max_gap_s: float = Field(default=0.1, gt=0.0, le=1.0, description="a longer gap moves no further")
    max_current: int = Field(default=20, ge=0, le=MAX_CURRENT, description="current field, wire unit")
    backoff_s: float = Field(default=0.5, gt=0.0, description="release of a motor after its first stall")
    max_backoff_s: float = Field(default=8.0, gt=0.0, description="it doubles with each stall up to this")
    calm_s: float = Field(default=5.0, gt=0.0, description="without a stall for so long, it starts anew")
    hand_limit_c: float = Field(default=55.0, gt=0.0, le=80.0, description="where the hand powers off")
    pause_c: float = Field(default=50.0, gt=0.0, description="a board this hot is released")
    resume_c: float = Field(default=45.0, gt=0.0, description="a released board this cool moves again")
    clearance_m: float = Field(
        default=round(FINGER_PITCH_M - 2 * FINGER_RADIUS_M, 6),
        gt=0.0,
        le=0.02,
        description="how far a curled finger may lean towards its neighbour",
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.resume_c < self.pause_c < self.hand_limit_c:
            raise ValueError("resume_c, pause_c and hand_limit_c must rise in this order")
        if self.max_backoff_s < self.backoff_s:
            raise ValueError("max_backoff_s must not be below backoff_s")
        return self


CONFIRM_ON_HARDWARE = (
    Confirm(
        "rate_rad_s",
        "1.5",
        "the model's placeholder; the real joints' speed is not public",
        "command a free joint end to end and differentiate its angle sensor",
    ),
    Confirm(
        "max_current",
        "20",
        "SDK's default; the wire's unit is not public",
        "raise it only with the force measured, see `current`",
    ),
    Confirm(
        "hand_limit_c",
        "55.0",
        "factory value of the safe temperature; where it is measured is not public",
        "read memory address 0x54 of each board",
    ),
    Confirm(
        "pause_c",
        "50.0",
        "one reading a finger board: whether it is that of the sensor or of the motors' driver is not public",
        "work one finger until it reads 45 and feel, or film with a thermal camera, what is warm",
    ),
    Confirm(
        "clearance_m",
        "0.0053",
        "distance of neighbouring fingers less two radii, from the vendor's model, not from a hand",
        "spread and curl slowly at low current and note where the fingers touch",
    ),
)

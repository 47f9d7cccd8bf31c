"""Options of hand_io."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from common.can_config import CanConfig
from common.cell import SharedConfig
from common.config import Frozen
from common.dexhand021.config import NO_CURRENT_LIMIT, Confirm, DexHandConfig
from common.dexhand021.glove_config import GloveConfig
from common.dexhand021.tables import MOTORS
from common.hand_messages import PoseSource
from services.hand_io.limits_config import LimitsConfig

Angle = Annotated[float, Field(ge=0.0, le=3.0)]
# Thumb dip, mcp, rotation; spread; dip and mcp of index, middle, ring, little: room for the die between them.
CUP_RAD: tuple[float, ...] = (0.5, 0.4, 0.6, 0.1, 0.6, 0.5, 0.6, 0.5, 0.6, 0.5, 0.6, 0.5)


class HandIoConfig(Frozen):
    """How the hand is driven, watched and armed."""

    limits: LimitsConfig = LimitsConfig()
    auto_arm: bool = Field(default=False, description="arm without a person; simulated buses only")
    set_point_hz: float = Field(default=50.0, ge=50.0, le=100.0, description="set points sent a second")
    hold_s: float = Field(default=10.0, gt=0.0, description="without a command: hold so long, then no torque")
    stale_ms: float = Field(default=200.0, gt=0.0, description="an older joint angle or force is not valid")
    pose_stale_ms: float = Field(default=300.0, gt=0.0, description="an older pose of the die is not valid")
    pose_quality: float = Field(default=0.5, ge=0.0, le=1.0, description="a pose below it is not valid")
    silent_s: float = Field(default=1.0, gt=0.0, description="a board silent for so long ends what runs")
    recover_s: float = Field(default=1.0, ge=0.0, description="without trouble for so long, a fault is over")
    reset_s: float = Field(default=2.0, gt=0.0, description="way to the start pose of an episode")
    settle_s: float = Field(default=1.0, ge=0.0, description="the die rests so long before an episode begins")
    start_rad: tuple[Angle, ...] = Field(
        default=CUP_RAD, min_length=MOTORS, max_length=MOTORS, description="joints when the die is laid in"
    )
    clear_s: float = Field(default=0.25, gt=0.0, description="pause before a latched error is cleared")
    max_clear_s: float = Field(default=4.0, gt=0.0, description="it doubles with each attempt up to this")
    reopen_s: float = Field(default=0.5, gt=0.0, description="pause before a lost bus is opened again")
    max_reopen_s: float = Field(default=5.0, gt=0.0, description="it doubles with each attempt up to this")


CONFIRM_ON_HARDWARE = (
    Confirm(
        "set_point_hz",
        "50.0",
        "the hand's highest rate of commands is not public; 50 to 150 Hz are in use, without BRS 200 fit",
        "raise it and watch age and rate of the boards on the dashboard: no reply may stay out",
    ),
)


class HandIoProcess(SharedConfig):
    """What the hand_io process is started with."""

    can: CanConfig = CanConfig()
    hand: DexHandConfig = DexHandConfig()
    hand_io: HandIoConfig = HandIoConfig()
    glove: GloveConfig = GloveConfig()
    pose_source: PoseSource = Field(default=PoseSource.TWIN, description="who tells where the die is")

    @model_validator(mode="after")
    def _armed_by_people(self) -> Self:
        if self.hand_io.auto_arm and not self.can.simulated:
            raise ValueError("hand_io.auto_arm: a hand that can hurt is armed by a person (deploy.arm)")
        return self

    @model_validator(mode="after")
    def _limited_by_current(self) -> Self:
        if not (self.hand.limits_current or self.can.simulated):
            raise ValueError(NO_CURRENT_LIMIT)
        return self

"""Options of the emulated hand, and the faults that it can be told to have."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, Self

from pydantic import Field, model_validator

from common.can_config import CanConfig
from common.cell import SharedConfig
from common.config import Frozen
from common.dexhand021.config import Confirm, DexHandConfig
from common.hand_messages import PoseSource
from services.sim.dexhand_physics import TwinPhysics


class FaultKind(StrEnum):
    """What can go wrong with a hand; the first six concern one board, the others the bus."""

    STALL = "stall"  # a motor is obstructed: it latches an error and is deaf until that is cleared
    WARM = "warm"  # the board reads `amount` °C
    OVERHEAT = "overheat"  # the board says so, and the hand is without power until the end
    NAN_TACTILE = "nan_tactile"
    SILENT = "silent"  # the board neither hears nor answers
    DRIFT = "drift"  # its angle sensors drift by `amount` rad/s; what has drifted stays
    DUPLICATE = "duplicate"  # each answer comes twice
    REORDER = "reorder"  # answers come backwards, and the last round's after this one's
    DELAY = "delay"  # answers come `amount` ms late
    BUS_OFF = "bus_off"
    POWER = "power"  # all boards are without power until the end, and then start anew


class Fault(Frozen):
    """One fault, from `at_s` after the start (or after it was told of) for `for_s`."""

    kind: FaultKind
    board: Literal["thumb", "palm", "index", "middle", "ring", "little"] = "index"
    motor: Literal[1, 2] = Field(default=1, description="of a stall: 1 distal, 2 proximal")
    at_s: float = Field(default=0.0, ge=0.0)
    for_s: float = Field(default=1.0, gt=0.0)
    amount: float = Field(default=0.0, description="see the kinds")


class EmulatorConfig(Frozen):
    """How the emulated hand answers, and the person beside it who lays the die in."""

    feedback_bytes: Literal[16, 42, 46, 48, 56, 64] = Field(
        default=56, description="length of a status, before padding to what CAN FD can express"
    )
    firmware: int = Field(default=25418, ge=0, le=65535, description="as read from a board's memory")
    startup_bytes: int = Field(default=8, ge=0, le=64, description="zeros in a start-up frame")
    silence_s: float = Field(default=0.5, gt=0.0, description="without a command for so long it goes limp")
    physics_hz: float = Field(default=100.0, ge=20.0, le=250.0, description="rounds of physics a second")
    pose_hz: float = Field(default=30.0, gt=0.0, le=100.0, description="poses of the die a second")
    lay_after_s: float = Field(
        default=1.0, gt=0.0, description="after a new episode or a drop, the die is laid into the still hand"
    )
    faults: tuple[Fault, ...] = ()


CONFIRM_ON_HARDWARE = (
    Confirm(
        "silence_s",
        "0.5",
        "whether and when the boards let go without commands is not public; hand_io lets go when it ends",
        "hold a joint at the lowest current, pull the adapter's cable, and time how long it resists",
    ),
    Confirm(
        "firmware",
        "25418",
        "the newest SDK's minimum, not enforced; no list of versions is public, and nothing depends on it",
        "`python -m deploy.doctor can` reads each board's",
    ),
    Confirm(
        "feedback_bytes",
        "56",
        "the longest that is documented; see `hand.feedback_bytes`",
        "`candump -x` shows the length of each board's replies",
    ),
    Confirm("startup_bytes", "8", "not public, see `hand.startup_frame`", "as there; nothing depends on it"),
)


class EmulatorProcess(SharedConfig):
    """What the emulator process is started with."""

    can: CanConfig = CanConfig()
    hand: DexHandConfig = DexHandConfig()
    emulator: EmulatorConfig = EmulatorConfig()
    twin: TwinPhysics = TwinPhysics()
    pose_source: PoseSource = Field(default=PoseSource.TWIN, description="who tells where the die is")

    @model_validator(mode="after")
    def _never_among_real_hands(self) -> Self:
        if not self.can.simulated:
            raise ValueError(f"can.interface: an emulated hand has no place on {self.can.interface}")
        return self

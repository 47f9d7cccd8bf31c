"""What is not public about the DexHand 021, as options with stated defaults, and how to confirm each.

Every row of CONFIRM_ON_HARDWARE belongs on the bench before the first powered run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from common.config import Frozen
from common.dexhand021.tables import (
    MAX_CURRENT,
    MAX_SPEED,
    MOTORS,
    ControlMode,
    Hand,
)

Sign = Literal[-1, 1]
Signs = Annotated[tuple[Sign, ...], Field(min_length=MOTORS, max_length=MOTORS)]
Ratio = Annotated[float, Field(gt=0.0, le=4.0)]

NO_CURRENT_LIMIT = (
    "hand.motion: board_short carries no limit of current: with a real hand it wants "
    "hand.accept_no_current_limit: true"
)
_MODES = {
    "cascaded_pid": ControlMode.CASCADED_PID,
    "mit_torque": ControlMode.MIT_TORQUE,
    "impedance_grasp": ControlMode.IMPEDANCE_GRASP,
}


class DexHandConfig(Frozen):
    """The hand as it is assumed to be; tables.py holds what its makers publish."""

    hand: Hand = Field(
        default=Hand.RIGHT, description="left or right; decides board ids. left goes with task die_left"
    )
    mode: Literal["cascaded_pid", "mit_torque", "impedance_grasp"] = Field(
        default="cascaded_pid", description="control mode; all three take angles"
    )
    motion: Literal["broadcast", "board", "board_short"] = Field(
        default="broadcast",
        description="one 64-byte frame, six of 12 bytes, or six of 6 for old firmware, "
        "which carry neither speed nor current",
    )
    accept_no_current_limit: bool = Field(
        default=False,
        description="board_short on a real bus: accept that hand.speed, hand.current and "
        "hand_io.limits.max_current have no effect",
    )
    bit_rate_switch: bool = Field(default=False, description="BRS on the frames that we send")
    feedback_bytes: Literal[16, 42, 46, 48, 56, 64] | None = Field(
        default=None, description="length of the firmware's status before padding; null: all that arrives"
    )
    speed: int = Field(default=15000, ge=0, le=MAX_SPEED, description="speed field, nominally motor rpm")
    current: int = Field(default=20, ge=0, le=MAX_CURRENT, description="current field, wire unit")
    signs: Signs = Field(default=(1,) * MOTORS, description="+1 where the hand counts flexion as positive")
    distal_sensor: Literal["pip", "dip"] = Field(
        default="pip", description="which of the two coupled joints the distal angle sensor reads"
    )
    distal_ratio: Ratio = Field(default=1.0, description="DIP angle per PIP angle")
    spread_ratios: tuple[Ratio, Ratio, Ratio] = Field(
        default=(1.0, 1.0, 2.0), description="index, ring and little finger's angle per spread motor angle"
    )

    startup_frame: Literal["restart", "ignored"] = Field(
        default="restart", description="what a frame of 0x400 + board says, whatever its bytes are"
    )

    @property
    def limits_current(self) -> bool:
        """Whether commands say what current may be drawn, or somebody has accepted that they do not."""
        return self.motion != "board_short" or self.accept_no_current_limit

    @property
    def control_mode(self) -> ControlMode:
        """The mode byte of motion commands."""
        return _MODES[self.mode]


@dataclass(frozen=True)
class Confirm:
    """One assumption: the option it is in, its default, why that default, how to confirm it.

    Without an option `field` is empty: nothing depends on it but what `default` says.
    """

    field: str
    default: str
    why: str
    how: str


CONFIRM_ON_HARDWARE = (
    Confirm(
        "mode",
        "cascaded_pid",
        "first SDK's default, 0x44; the newer one prefers 0x77, whose stiffness is not public",
        "command one free finger in either mode and compare angle sensor with set point",
    ),
    Confirm(
        "motion",
        "broadcast",
        "one frame instead of six; known to the newer SDKs only",
        "send a broadcast that enables one motor and see it move and six boards answer",
    ),
    Confirm(
        "accept_no_current_limit",
        "False",
        "frames of motion board_short carry neither speed nor current: no limit of ours reaches the motors",
        "with 12-byte frames first; if the firmware knows only 6, press one free fingertip on a scale",
    ),
    Confirm(
        "bit_rate_switch",
        "False",
        "the SDK sends single frames without BRS; what the hand replies with is not public",
        "look at the BRS bit of a reply (`candump -x`)",
    ),
    Confirm(
        "feedback_bytes",
        "None",
        "42 and 46 bytes arrive padded to 48, 56 to 64: only the firmware knows what is padding",
        "read firmware and frame length; with a healthy hand bytes 46 and 47 must be 0",
    ),
    Confirm(
        "speed",
        "15000",
        "SDK's default; nominally rpm, scaling unverified",
        "time a free joint over 60 degrees at 5000 and at 15000",
    ),
    Confirm(
        "current",
        "20",
        "SDK's default, the lowest in use (another example has 200); the unit on the wire is not public",
        "press a fingertip on a scale and raise it in steps of 10, watching the measured mA",
    ),
    Confirm(
        "signs",
        str((1,) * MOTORS),
        "flexion, opposition and spreading are positive in the SDK; the left hand is undocumented",
        "move each joint by hand and read its angle sensor",
    ),
    Confirm(
        "distal_sensor",
        "pip",
        "one motor bends PIP and DIP; the makers do not say where the sensor sits",
        "hold the middle phalanx, move the fingertip, and see whether the reading changes",
    ),
    Confirm(
        "distal_ratio",
        "1.0",
        "1:1 in all vendor software, measured nowhere",
        "photograph a finger from the side at five set points",
    ),
    Confirm(
        "spread_ratios",
        "(1.0, 1.0, 2.0)",
        "simulators of the maker disagree (1:1:2 and 1:1:1); the larger is the safer for interference",
        "photograph the spread hand from the palm side",
    ),
    Confirm(
        "",
        "the palm looks up, turned by 15 degrees about its long axis, thumb lower (common/task/die.py)",
        "the paper does not say how its hand is mounted; a dropped die and an uppermost face depend on it",
        "put a level on the back of the hand before the first episode",
    ),
    Confirm(
        "",
        "joints go no further than the narrower of the ranges of SDK and model (common/dexhand021/tables.py)",
        "they disagree: flexion 90 or 74.5 degrees, rotation 150 or 126, spread 30 or 17.2",
        "lower the current, command each end in turn, read the angle sensor and look whether it arrives",
    ),
    Confirm(
        "",
        "error codes are bit flags, and any of them releases the motor; the raw byte is logged",
        "so in three sources and in the only published capture (stall is 4); the newest SDK reads 3 as stall",
        "hold a finger back at low current and read the code in `hand/joints`",
    ),
    Confirm(
        "",
        "warning frames are counted, and nothing else is done about them",
        "the sources disagree whether code 1 is a Hall sensor's limit or a hot motor",
        "compare the counter `warnings` with angles and temperatures when it grows",
    ),
    Confirm(
        "startup_frame",
        "restart",
        "the layout is not public, so no byte of it is read; a board that has restarted ends what runs",
        "switch the hand on while `candump -x` runs: one such frame a board, or `ignored` if more follow",
    ),
)

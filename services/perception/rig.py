"""What stands around the hand for calibration: the plate, where its jig holds it, the palm's tag."""

# pyright: strict

from __future__ import annotations

from pydantic import Field

from common.config import Frozen
from services.perception.calibration import Dictionary, Pose
from services.perception.plate import PlateConfig


class TagConfig(Frozen):
    """The marker that is fixed to the palm's base."""

    dictionary: Dictionary = "DICT_4X4_50"
    number: int = Field(default=0, ge=0)


class RigConfig(Frozen):
    """Frames: the palm's as in common.task.die, the plate's as in services.perception.plate."""

    plate: PlateConfig = PlateConfig()
    jig: Pose | None = Field(default=None, description="of the plate in the palm's frame, when it is jigged")
    home: Pose | None = Field(
        default=None, description="of the palm in the arm's base while it works; for `robot_world`"
    )
    tag: TagConfig | None = Field(
        default=None, description="on the palm's base; without it a knock shows late"
    )
    views: int = Field(default=50, ge=1, description="to be captured; with an arm, one for each of its poses")
    serial: str = Field(default="", description="of the camera")

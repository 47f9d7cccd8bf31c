"""What the digital twin of the DexHand 021 assumes where nobody has measured a real hand."""

# pyright: strict

from __future__ import annotations

from pydantic import Field

from common.config import Frozen
from common.dexhand021.config import Confirm
from common.die import DIE


class TwinPhysics(Frozen):
    """Stiffness, torque, friction and timing; `*_nm` are N·m."""

    timestep_s: float = Field(default=0.002, gt=0.0, le=0.004, description="a coarser one blurs contacts")
    stiffness_nm_rad: float = Field(default=5.0, gt=0.0, description="of each motor's position loop")
    damping_nms_rad: float = Field(default=0.15, ge=0.0, description="of each motor's position loop")
    torque_nm: float = Field(
        default=1.0, gt=0.0, description="a motor's largest; gives the 10 N at a fingertip that are published"
    )
    friction_nms_rad: float = Field(default=0.05, ge=0.0, description="viscous friction of a joint")
    armature_kgm2: float = Field(default=0.002, gt=0.0, description="geared rotor as seen by the joint")
    finger_friction: float = Field(default=1.0, gt=0.0, description="Coulomb coefficient, finger on die")
    die_mass_kg: float = Field(default=DIE.mass_kg, gt=0.0, description="of the die")
    palm_friction: float = Field(default=1.0, gt=0.0, description="Coulomb coefficient, palm on die")
    current_ma_nm: float = Field(default=250.0, gt=0.0, description="motor current per torque")
    rate_rad_s: float = Field(default=1.5, gt=0.0, description="fastest set point, that of the limits gate")
    set_point_hz: float = Field(default=50.0, gt=0.0, description="set points on the way to an action")
    table_m: float = Field(default=0.16, gt=0.0, description="how far the table is below the palm's frame")


_PUSH = "step one free joint by 0.2 rad at the default current and fit the model's answer to the sensor's"
CONFIRM_ON_HARDWARE = (
    Confirm("stiffness_nm_rad", "5.0", "the maker's gains serve the simulator, not the hand", _PUSH),
    Confirm("damping_nms_rad", "0.15", "as above", _PUSH),
    Confirm("friction_nms_rad", "0.05", "the joints' friction is not public", _PUSH),
    Confirm("armature_kgm2", "0.002", "neither motors nor gears are public", _PUSH),
    Confirm(
        "torque_nm",
        "1.0",
        "real joint torque is not public; 10 N at a fingertip over 0.1 m are",
        "press a fingertip on a scale with the current that the cell allows",
    ),
    Confirm(
        "current_ma_nm",
        "250.0",
        "the motors' constants are not public",
        "the same scale: measured mA over force times lever",
    ),
    Confirm("rate_rad_s", "1.5", "see `hand_io.limits.rate_rad_s`", "as there; both must be the same"),
    Confirm(
        "finger_friction",
        "1.0",
        "rubber on plastic; the maker's simulated value is 3",
        "tilt a finger with the die on its pad until it slides: the tangent of that angle",
    ),
    Confirm("palm_friction", "1.0", "the paper calls it high", "the same with the palm"),
    Confirm(
        "die_mass_kg",
        "0.1",
        "the paper gives 60 mm only; this is the mass of the maker's simulated cube",
        "weigh the die",
    ),
)

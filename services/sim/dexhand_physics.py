"""What the digital twin of the DexHand 021 assumes where nobody has measured a real hand."""

# pyright: strict

from __future__ import annotations

from pydantic import Field

from common.config import Frozen


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
    palm_friction: float = Field(default=1.0, gt=0.0, description="Coulomb coefficient, palm on die")
    current_ma_nm: float = Field(default=250.0, gt=0.0, description="motor current per torque")
    rate_rad_s: float = Field(default=1.5, gt=0.0, description="fastest set point, that of the limits gate")
    set_point_hz: float = Field(default=50.0, gt=0.0, description="set points on the way to an action")
    table_m: float = Field(default=0.16, gt=0.0, description="how far the table is below the palm's frame")

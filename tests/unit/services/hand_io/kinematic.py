"""A twin without physics: powered joints go to their set points at a steady pace, others stay."""

from __future__ import annotations

import numpy as np

from common.dexhand021.tables import HIGH_RAD, LOW_RAD, MOTORS
from services.hand_io.config import CUP_RAD

PACE_RAD_S = 4.0


class KinematicTwin:
    """Moves joints and remembers how far each has ever been."""

    def __init__(self):
        self.joint_angles_rad = np.array(CUP_RAD)
        self.lowest, self.highest = self.joint_angles_rad.copy(), self.joint_angles_rad.copy()
        self.targets, self.powered = self.joint_angles_rad.copy(), np.zeros(MOTORS, bool)
        self.position, self.rotation = np.array([0.05, 0.0, 0.14]), np.array([1.0, 0.0, 0.0, 0.0])
        self.fingertip_forces_n = np.array([0.5, 0.1, 0.2, 0.3, 0.4])
        self.placed = 0

    @property
    def motor_currents_ma(self):
        return 40.0 * self.powered

    @property
    def holding(self):
        return bool(self.position[0] > 0)

    def set_targets(self, position_rad):
        self.targets = np.where(np.isnan(position_rad), self.targets, position_rad)

    def set_powered(self, powered):
        self.powered = np.array(powered)

    def advance(self, seconds):
        reach = np.where(self.powered, PACE_RAD_S * seconds, 0.0)
        here = self.joint_angles_rad
        self.joint_angles_rad = here + np.clip(self.targets - here, -reach, reach)
        self.lowest = np.minimum(self.lowest, self.joint_angles_rad)
        self.highest = np.maximum(self.highest, self.joint_angles_rad)

    def die_pose(self):
        return self.position.copy(), self.rotation.copy()

    def place_die(self, position_m, rotation):
        self.position, self.rotation = np.array(position_m), np.array(rotation)
        self.placed += 1

    @property
    def moved_rad(self):
        return float((self.highest - self.lowest).max())

    @property
    def within_limits(self):
        return bool((self.lowest >= LOW_RAD - 1e-9).all() and (self.highest <= HIGH_RAD + 1e-9).all())

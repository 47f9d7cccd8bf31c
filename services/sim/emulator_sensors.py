"""What the boards of an emulated hand measure, in the units of the wire."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.dexhand021.angles import to_hall_counts, to_wire_cdeg
from common.dexhand021.replies import BoardFeedback, MotorFlag, MotorState, Tactile
from common.dexhand021.tables import BOARDS, ENCODER_COUNTS_PER_DEG, MOTORS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

COUNTS_A_TURN = 6
_TIPS = [i for i, board in enumerate(BOARDS) if board.has_tactile]


class TwinLike(Protocol):
    """The physics behind the boards; angles (12,) rad, forces (5,) N, poses in the palm's frame."""

    @property
    def joint_angles_rad(self) -> Floats:
        """Angles (12,) that the motors turn."""
        ...

    @property
    def motor_currents_ma(self) -> Floats:
        """Currents (12,)."""
        ...

    @property
    def fingertip_forces_n(self) -> Floats:
        """Normal forces (5,)."""
        ...

    @property
    def holding(self) -> bool:
        """Whether the die is in the hand."""
        ...

    def set_targets(self, position_rad: ArrayLike) -> None:
        """Give new set points (12,); NaN leaves a motor's as it is."""
        ...

    def set_powered(self, powered: ArrayLike) -> None:
        """Switch motors (12,) on and off."""
        ...

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        ...

    def die_pose(self) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (4,) wxyz."""
        ...

    def place_die(self, position_m: ArrayLike, rotation: ArrayLike) -> None:
        """Put the resting die at a pose (3,), (4,)."""
        ...


class Sensors:
    """Readings of the last round of physics; `angle_rad` (12,) is the truth, without drift."""

    def __init__(self, twin: TwinLike, signs: tuple[int, ...]) -> None:
        self._twin = twin
        self._signs = np.array(signs)
        self.drift_rad = np.zeros(MOTORS)
        self.angle_rad = twin.joint_angles_rad.copy()
        self.measure(1.0)

    def measure(self, elapsed_s: float) -> None:
        """Read everything, `elapsed_s` after the last time."""
        angle = self._twin.joint_angles_rad.copy()
        speed_rpm = 60.0 / COUNTS_A_TURN * to_hall_counts((angle - self.angle_rad) / elapsed_s)
        self.angle_rad = angle
        currents, speeds = _i16(self._twin.motor_currents_ma), _i16(speed_rpm)
        counts = _i16(to_hall_counts(angle))
        angles = _i16(to_wire_cdeg(angle + self.drift_rad, self._signs))
        self._motors = [MotorState(*row) for row in zip(currents, speeds, counts, angles, strict=True)]
        encoders = np.rint(np.degrees(angle + self.drift_rad) * ENCODER_COUNTS_PER_DEG).astype(np.int64)
        self._encoders: list[int] = (encoders % 4096).tolist()
        self._force_n: list[float] = self._twin.fingertip_forces_n.tolist()

    def status(
        self, board: int, identity: int, temperature_c: int, latched: Bools, blind: bool
    ) -> BoardFeedback:
        """What board 0-5 says; `latched` motors (12,) have an error, a `blind` fingertip says NaN."""
        first, second = 2 * board, 2 * board + 1
        return BoardFeedback(
            board=identity,
            motors=(self._motors[first], self._motors[second]),
            tactile=self._tactile(board, blind) if BOARDS[board].has_tactile else None,
            temperature_c=temperature_c,
            encoders=(self._encoders[first], self._encoders[second]),
            errors=(_flag(latched[first]), _flag(latched[second])),
            impedances=(0.0, 0.0),
        )

    def _tactile(self, board: int, blind: bool) -> Tactile:
        return Tactile(
            normal_n=None if blind else self._force_n[_TIPS.index(board)],
            normal_change=0,
            tangential_n=None if blind else 0.0,
            tangential_change=0,
            direction_deg=None,
            proximity=0,
        )


def _flag(latched: np.bool_) -> MotorFlag:
    return MotorFlag.STALL if latched else MotorFlag(0)


def _i16(values: NDArray[Any]) -> list[int]:
    return np.clip(np.rint(values), -32768, 32767).astype(np.int64).tolist()

"""What a DexHand is drawn as, by motor, board and fingertip: paths, legends, colours, where forces act."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from common import geometry
from common.dexhand021.tables import BOARDS, JOINTS, Hand
from deploy.viewer.curves import FINGER_RGB, GREY, LIGHT_BLUE, ORANGE, RED, Arrows, Curves, Rgb
from services.hand_io.arming import State
from services.sim.dexhand_links import DISTAL_LINKS, PAD, PAD_TURN

MOTORS_A_BOARD = 2
BOARD_NAMES = tuple(board.name for board in BOARDS)
TIPS = tuple(board.name for board in BOARDS if board.has_tactile)
# In the order of BOARDS: thumb, palm, index, middle, ring, little.
BOARD_RGB: Mapping[str, Rgb] = MappingProxyType(
    dict(zip(BOARD_NAMES, (FINGER_RGB[4], GREY, *FINGER_RGB[:4]), strict=True))
)
_MOTOR_RGB = (LIGHT_BLUE, ORANGE)  # of a board's first and second motor
HAND_LANE: Mapping[str, Rgb] = MappingProxyType(
    {
        State.HOLD: (120, 120, 130),
        State.ARMED: (60, 120, 200),
        State.RUNNING: (60, 160, 95),
        State.RELAX: (225, 150, 50),
        State.FAULT: RED,
    }
)

# A force is drawn behind the fingertip that feels it, along the way it pushes.
BEHIND_M = 0.022  # from the pad to the back of the fingertip
FORCE_M_N = 0.004
LONGEST_M = 0.08


def motors_of(board: int) -> tuple[str, ...]:
    """The joints that the motors of board 0-5 turn."""
    first = MOTORS_A_BOARD * board
    return tuple(joint.name for joint in JOINTS[first : first + MOTORS_A_BOARD])


def hand_curves() -> tuple[Curves, ...]:
    """All entities of a hand that hold curves."""
    motors = [
        (name, rgb) for i in range(len(BOARDS)) for name, rgb in zip(motors_of(i), _MOTOR_RGB, strict=True)
    ]
    return (
        *(
            Curves(f"hand/angle_rad/{name}", (name, f"{name} target"), (rgb, _dim(rgb)))
            for name, rgb in motors
        ),
        *(Curves(f"hand/current_ma/{name}", motors_of(i), _MOTOR_RGB) for i, name in enumerate(BOARD_NAMES)),
        *(
            Curves(f"hand/{what}/{name}", (name,), (rgb,))
            for what in ("temperature_c", "age_ms", "rate_hz")
            for name, rgb in BOARD_RGB.items()
        ),
        *(Curves(f"hand/force_n/{tip}", (tip,), (BOARD_RGB[tip],)) for tip in TIPS),
    )


def force_arrows() -> tuple[Arrows, ...]:
    """One arrow for each fingertip, which moves with its distal link."""
    return tuple(
        Arrows(force_path(tip), body, BOARD_RGB[tip]) for tip, body in zip(TIPS, DISTAL_LINKS, strict=True)
    )


def force_path(tip: str) -> str:
    """Where the arrow of a fingertip is drawn."""
    return f"world/force/{tip}"


def force_arrow(force_n: float, hand: Hand) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origin (3,) and vector (3,), m, distal link's frame, of a force on its pad; at most LONGEST_M long."""
    side = 1.0 if hand is Hand.RIGHT else -1.0
    turn = geometry.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(side * PAD_TURN))
    inwards = geometry.rotate(turn, np.array([0.0, -side, 0.0]))
    pad = np.array([PAD[0], side * PAD[1], PAD[2]])
    length_m = min(max(force_n, 0.0) * FORCE_M_N, LONGEST_M)
    return pad + BEHIND_M * inwards, length_m * inwards


def _dim(rgb: Rgb) -> Rgb:
    red, green, blue = (round(0.55 * level) for level in rgb)
    return red, green, blue

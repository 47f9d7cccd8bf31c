"""What the driver tells the service: one HandFrame from boards and set points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.hand_messages import HandFrame, Link
from common.message_fields import Float32, UInt8
from services.hand_io.boards import Boards
from services.hand_io.set_points import SetPoints

LONGEST_MS = 1e6  # what an age that nobody knows is told as
LARGEST = 1e5  # a float32 sensor may say anything


def hand_frame(
    now_ns: int, link: Link, boards: Boards, points: SetPoints, counts: dict[str, float], *, error: str
) -> HandFrame:
    """Put together what is known at `now_ns`; NaN becomes 0 and not valid."""
    return HandFrame(
        t_ns=now_ns,
        link=link,
        drive=points.drive,
        angle_rad=_filled(boards.angle_rad),
        target_rad=_filled(points.sent.position_rad),
        enabled=points.sent.enabled.astype(np.uint8),
        limited=points.limited.astype(np.uint8),
        current_ma=_filled(boards.current_ma),
        flags=boards.flags.astype(np.uint8),
        force_n=_filled(boards.force_n),
        force_valid=_valid(boards.force_n),
        temperature_c=_filled(boards.temperature_c),
        temperature_valid=_valid(boards.temperature_c),
        age_ms=np.clip(boards.age_ns(now_ns) / 1e6, 0.0, LONGEST_MS).astype(np.float32),
        rate_hz=np.minimum(boards.rate_hz(now_ns), LARGEST).astype(np.float32),
        overheated=boards.overheated.astype(np.uint8),
        counts=counts,
        error=error,
    )


def _filled(values: NDArray[np.float64]) -> Float32:
    return np.where(_valid(values), values, 0.0).astype(np.float32)


def _valid(values: NDArray[np.float64]) -> UInt8:
    return (np.abs(values) <= LARGEST).astype(np.uint8)

"""The last gate before the wire: it knows nothing of planners, only what the hand bears.

Letters: 12 motors in the order of common.dexhand021.tables.JOINTS, 6 boards in that of BOARDS. Angles are
radians, positive in flexion. Pure: time comes in as `now_ns`, and nothing is sent from here.
"""

# pyright: strict

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import BOARDS, FINGER_LINKS_M, HIGH_RAD, LOW_RAD, MOTORS
from services.hand_io.limits_config import LimitsConfig

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
Int64 = NDArray[np.int64]

SPREAD = 3
DISTAL = np.array([4, 8, 10])  # of the fingers that the spread motor leans: index, ring, little
PROXIMAL = np.array([5, 9, 11])
MOTORS_A_BOARD = 2
NS_PER_S = 1e9


class Reason(StrEnum):
    """Why a request was changed; the first four count motors and calls, the others count events."""

    RANGE = "range"
    RATE = "rate"
    CURRENT = "current"
    UNMEASURED = "unmeasured"  # a motor whose angle was never seen does not move
    REFUSED = "refused"  # a request that is not finite or not twelve numbers: the hand holds
    INTERFERENCE = "interference"  # a motor kept back so that fingers do not meet
    STALL = "stall"
    TEMPERATURE = "temperature"


@dataclass(frozen=True)
class Request:
    """What somebody wants: positions (12,) rad and currents (12,) in the wire's unit."""

    position_rad: Float64
    current: Int64


@dataclass(frozen=True)
class Sensed:
    """What the hand last reported; NaN stands for unknown.

    `angle_rad` (12,), `temperature_c` (6,), `flagged` (12,): a motor with any error flag set, `lost` (12,):
    one whose board may have been without power.
    """

    angle_rad: Float64
    temperature_c: Float64
    flagged: Bool
    lost: Bool = field(default_factory=lambda: np.zeros(MOTORS, np.bool_))


@dataclass(frozen=True)
class SafeSetPoints:
    """What may go to the wire: positions (12,) rad in range, currents (12,), and which motors may work.

    A motor that is not enabled has current 0 and carries its measured position (or 0 if never measured).
    """

    position_rad: Float64
    current: Int64
    enabled: Bool


class Gate:
    """Turns requests into safe set points, one call per frame sent; `counts` says what it had to change.

    In order: range, rate, finger interference, current; stalled and lost motors and hot boards are released.
    A motor starts, and starts again after a release, from where its sensor says it is.
    """

    def __init__(self, limits: LimitsConfig, hand: DexHandConfig) -> None:
        self._limits = limits
        self._ratios = np.array(hand.spread_ratios)
        self._distal_ratio = hand.distal_ratio
        self._set_rad = np.full(MOTORS, np.nan)  # NaN: not following any set point
        self._current = np.zeros(MOTORS, np.int64)
        self._hot = np.zeros(len(BOARDS), np.bool_)
        self._release_s = np.zeros(MOTORS)  # length of the last release
        self._released_until_ns = np.zeros(MOTORS, np.int64)
        self._then_ns: int | None = None
        self.counts: Counter[Reason] = Counter()

    def step(self, now_ns: int, request: Request, sensed: Sensed) -> SafeSetPoints:
        """The safe version of `request` at `now_ns` (monotonic); never raises, whatever the numbers."""
        start, enabled = self._start(now_ns, sensed)
        reach_rad = np.where(enabled, self._limits.rate_rad_s * self._elapsed_s(now_ns), 0.0)
        target = self._within_range(self._accepted(request, start))
        moved = np.clip(target, start - reach_rad, start + reach_rad)
        self._count(Reason.RATE, enabled & (moved != target))
        apart = self._apart(start, moved, reach_rad)
        self._set_rad = np.where(enabled, apart, np.nan)
        return SafeSetPoints(apart, np.where(enabled, self._current, 0), enabled)

    def _start(self, now_ns: int, sensed: Sensed) -> tuple[Float64, Bool]:
        released = self._stalled(now_ns, sensed.flagged) | self._too_hot(sensed.temperature_c) | sensed.lost
        measured = np.clip(sensed.angle_rad, LOW_RAD, HIGH_RAD)
        start = np.where(released | np.isnan(self._set_rad), measured, self._set_rad)
        unmeasured = np.isnan(start)
        self._count(Reason.UNMEASURED, unmeasured)
        return np.where(unmeasured, LOW_RAD, start), ~(released | unmeasured)

    def _elapsed_s(self, now_ns: int) -> float:
        # A clock that stands still or jumps, and the first call, must not let a joint leap.
        then_ns, self._then_ns = self._then_ns, now_ns
        if then_ns is None:
            return 0.0
        return min(max((now_ns - then_ns) / NS_PER_S, 0.0), self._limits.max_gap_s)

    def _accepted(self, request: Request, start: Float64) -> Float64:
        shapes = request.position_rad.shape, request.current.shape
        if shapes != ((MOTORS,), (MOTORS,)) or not np.all(np.isfinite(request.position_rad)):
            self.counts[Reason.REFUSED] += 1
            return start
        self._current = np.clip(request.current, 0, self._limits.max_current)
        self._count(Reason.CURRENT, self._current != request.current)
        return request.position_rad

    def _within_range(self, position_rad: Float64) -> Float64:
        inside = np.clip(position_rad, LOW_RAD, HIGH_RAD)
        self._count(Reason.RANGE, inside != position_rad)
        return inside

    def _apart(self, start: Float64, moved: Float64, reach_rad: Float64) -> Float64:
        """Keep curled fingers from leaning into each other: first the spread gives way, then the curling.

        From set points that are apart this leads to none that are not; from others it never leads further in.
        """
        apart = moved.copy()
        allowed = self._allowed_spread_rad(moved)
        spread = max(min(moved[SPREAD], allowed.min()), start[SPREAD] - reach_rad[SPREAD])
        apart[SPREAD] = spread
        # Only what would lead further in waits: a finger found leaning may uncurl under a spread that stays.
        waiting = np.minimum(spread, self._allowed_spread_rad(start)) > allowed
        for joints in (DISTAL, PROXIMAL):
            apart[joints] = np.where(waiting, start[joints], moved[joints])
        self._count(Reason.INTERFERENCE, apart != moved)
        return apart

    def _allowed_spread_rad(self, position_rad: Float64) -> Float64:
        """Spread motor angle (3,) at which the curled tip of index, ring, little uses up the clearance.

        A finger leans outward by the spread; once it is curled past a right angle its tip lies behind the
        spread axis, and the same lean brings it inward, onto the finger that leans less.
        """
        knuckle, proximal, middle, distal = FINGER_LINKS_M
        mcp, pip = position_rad[PROXIMAL], position_rad[DISTAL]
        reach = knuckle + proximal * np.cos(mcp) + middle * np.cos(mcp + pip)
        reach += distal * np.cos(mcp + pip + self._distal_ratio * pip)
        behind_m = np.maximum(-reach, self._limits.clearance_m)
        return np.arcsin(self._limits.clearance_m / behind_m) / self._ratios

    def _stalled(self, now_ns: int, flagged: Bool) -> Bool:
        limits = self._limits
        over = now_ns >= self._released_until_ns
        calm = now_ns >= self._released_until_ns + round(limits.calm_s * NS_PER_S)
        again = np.where(calm, 0.0, 2.0 * self._release_s)
        stalls = over & flagged
        self._release_s = np.where(
            stalls, np.clip(again, limits.backoff_s, limits.max_backoff_s), self._release_s
        )
        until_ns = now_ns + (self._release_s * NS_PER_S).astype(np.int64)
        self._released_until_ns = np.where(stalls, until_ns, self._released_until_ns)
        self._count(Reason.STALL, stalls)
        return now_ns < self._released_until_ns

    def _too_hot(self, temperature_c: Float64) -> Bool:
        # A board without a reading, as the palm's, counts as hot as the hottest; without any nothing changes.
        felt_c = np.where(np.isnan(temperature_c), np.fmax.reduce(temperature_c), temperature_c)
        hot = (felt_c >= self._limits.pause_c) | (self._hot & ~(felt_c <= self._limits.resume_c))
        self._count(Reason.TEMPERATURE, hot & ~self._hot)
        self._hot = hot
        return np.repeat(hot, MOTORS_A_BOARD)

    def _count(self, reason: Reason, where: Bool) -> None:
        self.counts[reason] += int(np.count_nonzero(where))

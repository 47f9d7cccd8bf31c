"""The gate's rule against fingers that meet; the mutation test runs these against mutants as well.

A fingertip lies at 17 + 43 cos m + 25 cos(m + p) + 35 cos(m + 2 p) mm from its spread axis, with m the MCP's
and p the PIP's angle; behind it, where this is negative, the spread leans it inward.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from common.dexhand021.config import DexHandConfig
from services.hand_io import limits
from tests.unit.services.hand_io.gates import TICK_NS, Bench, angles

STEP_RAD = 1.5 * TICK_NS / 1e9
CURLED, BENT = 1.29, 1.0  # rad, at the MCP and the PIP: less at the PIP reaches further back


def _spread_limit_rad(m: float, p: float, ratio: float, distal_ratio: float = 1.0) -> float:
    far = 17 + 43 * math.cos(m) + 25 * math.cos(m + p) + 35 * math.cos(m + p + distal_ratio * p)
    return math.asin(5.3 / -far) / ratio


CASES = [((4, 5), 1.0), ((8, 9), 1.0), ((10, 11), 2.0)]  # index, ring and little finger


def _spread_bench(curled: tuple[int, int] | None, spread: float, **options: float) -> Bench:
    changes = [(motor, 0.0) for motor in (4, 5, 6, 7, 8, 9, 10, 11)]
    changes += zip(curled or (), (BENT, CURLED), strict=False)
    bench = Bench(limits, angle_rad=angles(*changes, (3, spread)), **options)
    bench.ask(bench.angle_rad)
    return bench


@pytest.mark.parametrize(("finger", "ratio"), CASES)
def test_the_spread_stops_where_a_curled_finger_would_meet_its_neighbour(
    finger: tuple[int, int], ratio: float
) -> None:
    bench = _spread_bench(finger, 0.0)
    limit = _spread_limit_rad(CURLED, BENT, ratio)
    for _ in range(20):
        safe = bench.ask(angles((3, 0.2998), base=bench.angle_rad))
    assert safe.position_rad[3] == pytest.approx(limit, abs=1e-9)
    assert bench.count("interference") == 20 - math.floor(limit / STEP_RAD)
    assert np.array_equal(np.delete(safe.position_rad, 3), np.delete(bench.angle_rad, 3))


@pytest.mark.parametrize("motor", [6, 7])
def test_the_middle_finger_may_curl_as_it_likes(motor: int) -> None:
    bench = _spread_bench((6, 7), 0.2998)
    safe = bench.ask(bench.angle_rad)
    assert safe.position_rad[3] == 0.2998 and safe.position_rad[motor] == bench.angle_rad[motor]
    assert bench.count("interference") == 0


def test_a_straight_hand_may_spread_fully() -> None:
    bench = _spread_bench(None, 0.0)
    for _ in range(20):
        safe = bench.ask(angles((3, 0.2998), base=bench.angle_rad))
    assert safe.position_rad[3] == 0.2998
    assert bench.count("interference") == 0


def test_a_curling_finger_waits_until_the_spread_has_given_way() -> None:
    bench = _spread_bench(None, 0.2998)
    wanted = angles((10, CURLED), (11, CURLED), base=bench.angle_rad)
    final = _spread_limit_rad(CURLED, CURLED, 2.0)
    previous = bench.ask(bench.angle_rad).position_rad
    for _ in range(80):
        safe = bench.ask(wanted).position_rad
        assert previous[3] - STEP_RAD - 1e-12 <= safe[3] <= previous[3]
        previous = safe
    assert safe[3] == pytest.approx(final, abs=1e-9)
    assert safe[10] == CURLED and safe[11] == CURLED


def test_where_the_palm_cannot_move_the_finger_waits_and_may_go_back() -> None:
    curl = 1.15  # m + 2 p beyond which a spread of 0.25 is too much for the little finger lies before this
    start = angles(*[(motor, 0.0) for motor in range(4, 12)], (3, 0.25))
    bench = Bench(limits, angle_rad=start)
    bench.temperature_c[1] = 60.0
    wanted = angles((10, curl), (11, curl), base=start)
    for _ in range(60):
        safe = bench.ask(wanted)
    held = safe.position_rad
    assert held[3] == 0.25 and not safe.enabled[3]
    assert held[10] == held[11] < curl
    bench.gate.counts.clear()
    assert bench.ask(wanted).position_rad[10] == held[10]
    assert bench.interventions() == {"rate": 2, "interference": 2}
    back = bench.ask(start).position_rad
    assert back[10] == pytest.approx(held[10] - STEP_RAD)
    assert back[11] == pytest.approx(held[11] - STEP_RAD)


def test_a_hand_found_interfering_may_uncurl_but_not_curl_further() -> None:
    start = angles(*[(motor, 0.0) for motor in range(4, 12)], (3, 0.2998), (10, 1.1), (11, 1.1))
    for wanted, expected in ((1.2, 1.1), (1.0, 1.1 - STEP_RAD)):
        bench = Bench(limits, angle_rad=start)
        bench.temperature_c[1] = 60.0
        bench.ask(start)
        safe = bench.ask(angles((10, wanted), (11, wanted), base=start)).position_rad
        assert safe[10] == safe[11] == pytest.approx(expected)


def test_the_coupling_and_the_spread_ratios_come_from_the_hand_s_options() -> None:
    hand = DexHandConfig(distal_ratio=0.9, spread_ratios=(1.0, 1.0, 1.5))
    start = angles(*[(motor, 0.0) for motor in range(4, 10)], (3, 0.0), (10, CURLED), (11, CURLED))
    bench = Bench(limits, angle_rad=start, rate_rad_s=10.0)
    bench.gate = limits.Gate(bench.config, hand)
    bench.ask(start)
    for _ in range(3):
        safe = bench.ask(angles((3, 0.2998), base=start)).position_rad
    assert safe[3] == pytest.approx(_spread_limit_rad(CURLED, CURLED, 1.5, 0.9), abs=1e-9)

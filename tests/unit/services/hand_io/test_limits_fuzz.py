"""Whatever is asked and reported, what leaves the gate is safe."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from common.dexhand021.tables import FINGER_LINKS_M, HIGH_RAD, LOW_RAD, MOTORS
from services.hand_io import limits
from tests.unit.services.hand_io.gates import Bench

CLEARANCE_M = 0.0053
FINGERS = ((5, 4, 1.0), (9, 8, 1.0), (11, 10, 2.0))  # MCP, PIP, spread per motor angle


def _lean_m(position_rad: Any, mcp: int, pip: int, ratio: float) -> float:
    """How far a tip leans towards the finger beside it, by a route of its own: complex numbers."""
    m, p = position_rad[mcp], position_rad[pip]
    turns = (0.0, m, m + p, m + 2 * p)
    tip = sum(length * np.exp(1j * turn) for length, turn in zip(FINGER_LINKS_M, turns, strict=True))
    return -float(tip.real) * math.sin(ratio * position_rad[3])


ANY = st.one_of(st.floats(), st.floats(-0.5, 2.5), st.sampled_from([0.0, 1.3, 2.2, 0.3, math.nan, math.inf]))
ASKED = st.one_of(
    st.lists(ANY, min_size=12, max_size=12), st.lists(st.floats(0.0, 1.3), min_size=12, max_size=12)
)
MEASURED = st.lists(st.one_of(st.floats(-0.2, 2.6), st.just(math.nan)), min_size=12, max_size=12)
WARM = st.lists(st.one_of(st.floats(0, 70), st.just(math.nan), st.just(4e9)), min_size=6, max_size=6)
TICK = st.fixed_dictionaries(
    {
        "asked": ASKED,
        "current": st.lists(st.integers(-(2**40), 2**40), min_size=12, max_size=12),
        "warm": st.one_of(st.just([30.0] * 6), WARM),
        "flagged": st.one_of(st.just([False] * 12), st.lists(st.booleans(), min_size=12, max_size=12)),
        "measured": MEASURED,
        "after_ns": st.one_of(st.just(20_000_000), st.integers(-(10**9), 10**10)),
    }
)


@given(MEASURED, st.lists(TICK, min_size=1, max_size=12))
@settings(max_examples=150, deadline=None)
def test_nothing_unsafe_leaves_the_gate(measured: list[float], ticks: list[dict[str, Any]]) -> None:
    bench = Bench(limits, angle_rad=measured, max_current=255)
    worked = np.zeros(MOTORS, np.bool_)
    before = np.zeros(MOTORS)
    for tick in ticks:
        bench.angle_rad = np.array(tick["measured"])
        bench.temperature_c, bench.flagged = np.array(tick["warm"]), np.array(tick["flagged"])
        safe = bench.ask(tick["asked"], np.array(tick["current"]), tick["after_ns"])
        assert np.all(np.isfinite(safe.position_rad))
        assert np.all((safe.position_rad >= LOW_RAD) & (safe.position_rad <= HIGH_RAD))
        assert np.all((safe.current >= 0) & (safe.current <= 255))
        assert not np.any(safe.current[~safe.enabled]) and not np.any(safe.enabled & bench.flagged)
        assert not np.any(np.repeat(bench.temperature_c >= 50.0, 2) & safe.enabled)
        going = worked & safe.enabled
        step_rad = 1.5 * min(max(tick["after_ns"] / 1e9, 0.0), 0.1)
        assert np.all(np.abs(safe.position_rad - before)[going] <= step_rad + 1e-12)
        worked, before = safe.enabled, safe.position_rad


@given(st.lists(st.lists(st.floats(-1, 3), min_size=12, max_size=12), min_size=1, max_size=40))
@settings(max_examples=100, deadline=None)
def test_an_open_hand_is_never_led_into_interference(targets: list[list[float]]) -> None:
    bench = Bench(limits, angle_rad=LOW_RAD, rate_rad_s=10.0)
    for target in targets:
        safe = bench.ask(target)
        for mcp, pip, ratio in FINGERS:
            assert _lean_m(safe.position_rad, mcp, pip, ratio) <= CLEARANCE_M + 1e-9

"""Set points between two actions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.hand_io.interpolate import Ramp

PERIOD_NS = 333_333_333  # 3 Hz
NOW_NS = 10**18


def test_a_ramp_is_straight_and_meets_both_ends() -> None:
    begin, end = np.array([0.0, 1.0]), np.array([1.0, 0.9])
    ramp = Ramp(NOW_NS, 1000, begin, end)
    for after_ns, share in ((-10, 0.0), (0, 0.0), (250, 0.25), (500, 0.5), (1000, 1.0), (10**9, 1.0)):
        assert np.allclose(ramp.at(NOW_NS + after_ns), begin + share * (end - begin), rtol=0, atol=1e-15)
    assert np.array_equal(ramp.at(NOW_NS), begin) and np.array_equal(ramp.at(NOW_NS + 1000), end)


def test_without_an_action_the_hand_stays() -> None:
    ramp = Ramp.still(NOW_NS, np.full(12, 0.5))
    assert all(
        np.array_equal(ramp.at(NOW_NS + after_ns), np.full(12, 0.5)) for after_ns in (-5, 0, 5, 10**10)
    )


def test_a_new_action_takes_over_without_a_jump() -> None:
    ramp = Ramp.still(NOW_NS, np.zeros(1)).towards(NOW_NS, np.ones(1), PERIOD_NS)
    early_ns = NOW_NS + PERIOD_NS // 3
    turned = ramp.towards(early_ns, np.zeros(1), PERIOD_NS)
    assert turned.at(early_ns)[0] == pytest.approx(1 / 3)
    assert turned.at(early_ns + PERIOD_NS // 2)[0] == pytest.approx(1 / 6)
    assert turned.at(early_ns + PERIOD_NS)[0] == 0.0


def test_a_non_finite_target_does_not_outlive_its_ramp() -> None:
    bad = Ramp.still(NOW_NS, np.array([0.2, 0.4])).towards(NOW_NS, np.array([np.nan, 0.6]), 1000)
    assert np.isnan(bad.at(NOW_NS + 500)[0])  # for the limits to refuse
    good = bad.towards(NOW_NS + 500, np.array([0.3, 0.5]), 1000)
    assert np.allclose(good.at(NOW_NS + 500), [0.2, 0.5])
    assert np.allclose(good.at(NOW_NS + 1500), [0.3, 0.5])


@pytest.mark.parametrize("duration_ns", [0, -1])
def test_a_ramp_takes_time(duration_ns: int) -> None:
    with pytest.raises(ValueError, match="not positive"):
        Ramp.still(NOW_NS, np.zeros(1)).towards(NOW_NS, np.ones(1), duration_ns)


@given(st.lists(st.floats(0, 2), min_size=2, max_size=8), st.integers(10, 100))
@settings(max_examples=60, deadline=None)
def test_set_points_stay_between_their_ends_and_take_even_steps(targets: list[float], rate_hz: int) -> None:
    ramp, now_ns = Ramp.still(NOW_NS, np.array(targets[:1])), NOW_NS
    for begin, end in itertools.pairwise(targets):
        ramp = ramp.towards(now_ns, np.array([end]), PERIOD_NS)
        times_ns = range(now_ns, now_ns + PERIOD_NS, 10**9 // rate_hz)
        points = np.array([ramp.at(time_ns)[0] for time_ns in times_ns])
        assert np.all((points >= min(begin, end) - 1e-12) & (points <= max(begin, end) + 1e-12))
        assert np.allclose(np.diff(points), (end - begin) * (10**9 // rate_hz) / PERIOD_NS, atol=1e-9)
        now_ns += PERIOD_NS

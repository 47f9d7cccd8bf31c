"""Ticks keep absolute deadlines: late ones are skipped and counted, never made up for in a burst."""

from hypothesis import given
from hypothesis import strategies as st

from common.clock import Ticker, VirtualClock, WallClock


def test_ticks_come_at_multiples_of_the_period():
    ticker = Ticker(10, 100)
    assert [ticker.take(now) for now in (99, 100, 100, 109, 110, 125, 130)] == [0, 1, 0, 0, 1, 1, 1]
    assert ticker.next_ns == 140


def test_missed_ticks_are_returned_once_and_the_phase_is_kept():
    ticker = Ticker(10, 0)
    assert ticker.take(0) == 1
    assert ticker.take(47) == 4  # 10, 20, 30, 40
    assert ticker.take(47) == 0
    assert ticker.take(49) == 0
    assert ticker.take(50) == 1


@given(
    period=st.integers(1, 10**9),
    start=st.integers(0, 10**18),
    waits=st.lists(st.integers(0, 10**10), max_size=40),
)
def test_every_deadline_is_counted_exactly_once_whenever_one_looks(period, start, waits):
    ticker, now, total = Ticker(period, start), start, 0
    for wait in waits:
        now += wait
        due = now >= ticker.next_ns
        taken = ticker.take(now)
        total += taken
        assert (taken > 0) == due
        assert ticker.take(now) == 0  # no burst
        assert now < ticker.next_ns <= now + period
        assert (ticker.next_ns - start) % period == 0
        assert total == (now - start) // period + 1


def test_the_virtual_clock_stands_still_until_it_is_moved():
    clock = VirtualClock(5)
    assert (clock.now_ns(), clock.now_ns()) == (5, 5)
    clock.time_ns = 9
    assert clock.now_ns() == 9


def test_the_wall_clock_never_steps_back():
    clock = WallClock()
    times = [clock.now_ns() for _ in range(1000)]
    assert times == sorted(times)

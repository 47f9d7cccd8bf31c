"""The last gate, rule by rule and at each rule's very edge; the mutation test runs these against mutants."""

from __future__ import annotations

import math

import numpy as np
import pytest

from common.config import ConfigError, parse
from common.dexhand021.tables import HIGH_RAD, LOW_RAD
from services.hand_io import limits
from services.hand_io.limits_config import LimitsConfig
from tests.unit.services.hand_io.gates import COOL_C, MIDDLE, TICK_NS, Bench, angles

STEP_RAD = 1.5 * TICK_NS / 1e9
MS = 1_000_000


def test_what_is_allowed_passes_unchanged() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    wanted = MIDDLE + 0.01
    safe = bench.ask(wanted, current=np.arange(12))
    assert np.array_equal(safe.position_rad, wanted)
    assert safe.current.tolist() == list(range(12))
    assert safe.enabled.tolist() == [True] * 12
    assert bench.interventions() == {}


def test_the_first_call_moves_nothing() -> None:
    bench = Bench(limits)
    assert np.array_equal(bench.ask(MIDDLE + 0.01).position_rad, MIDDLE)


def test_positions_stay_in_range() -> None:
    bench = Bench(limits, rate_rad_s=10.0, max_gap_s=1.0)
    bench.ask(MIDDLE)
    assert np.array_equal(bench.ask(np.full(12, -9.0), after_ns=10**9).position_rad, LOW_RAD)
    assert bench.count("range") == 12
    safe = bench.ask(angles((2, 9.0)), after_ns=10**9)
    assert safe.position_rad[2] == HIGH_RAD[2]
    assert bench.interventions() == {"range": 13}
    bench.ask(angles((2, float(HIGH_RAD[2])), (0, 0.0)), after_ns=10**9)
    assert bench.count("range") == 13  # the ends belong to the range


def test_a_joint_pushed_out_of_range_is_led_from_the_range_s_end() -> None:
    bench = Bench(limits, angle_rad=angles((0, 1.5), (1, -0.1)))
    safe = bench.ask(MIDDLE)
    assert (safe.position_rad[0], safe.position_rad[1]) == (HIGH_RAD[0], 0.0)


def test_set_points_move_no_faster_than_the_rate() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    wanted = angles((0, 1.3), (1, 0.0))
    safe = bench.ask(wanted)
    assert safe.position_rad[0] == MIDDLE[0] + STEP_RAD
    assert safe.position_rad[1] == MIDDLE[1] - STEP_RAD
    assert np.array_equal(safe.position_rad[2:], MIDDLE[2:])
    assert bench.count("rate") == 2
    again = bench.ask(wanted)
    assert again.position_rad[0] == pytest.approx(MIDDLE[0] + 2 * STEP_RAD)
    assert bench.interventions() == {"range": 2, "rate": 4}  # 1.3 rad is beyond the end


def test_a_gap_a_standing_clock_and_a_backward_one_allow_no_leap() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    wanted = angles((0, 1.2))
    assert bench.ask(wanted, after_ns=10**10).position_rad[0] == pytest.approx(MIDDLE[0] + 0.15)
    for after_ns in (0, -(10**10)):
        before = bench.ask(wanted, after_ns=0).position_rad[0]
        assert bench.ask(wanted, after_ns=after_ns).position_rad[0] == before
    assert bench.ask(wanted).position_rad[0] == pytest.approx(MIDDLE[0] + 0.15 + STEP_RAD)


def test_only_working_motors_count_as_slowed() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    bench.flagged[0] = True
    bench.ask(angles((0, 1.2), (1, 1.2)))
    assert bench.interventions() == {"stall": 1, "rate": 1}


def test_currents_stay_in_their_byte_and_below_the_limit() -> None:
    bench = Bench(limits, max_current=255)
    safe = bench.ask(MIDDLE, current=np.array([-1, 0, 1, 254, 255, 256, 10**9, 5, 5, 5, 5, 5]))
    assert safe.current.tolist() == [0, 0, 1, 254, 255, 255, 255, 5, 5, 5, 5, 5]
    assert bench.interventions() == {"current": 3}
    assert Bench(limits, max_current=7).ask(MIDDLE, current=8).current.tolist() == [7] * 12


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_non_finite_request_is_refused_and_the_hand_holds(wrong: float) -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE, current=30)
    held = bench.ask(MIDDLE + 0.01, current=30).position_rad
    safe = bench.ask(angles((11, wrong)), current=40)
    assert np.array_equal(safe.position_rad, held)
    assert safe.current.tolist() == [30] * 12
    assert bench.interventions() == {"refused": 1}


def test_a_request_of_another_shape_is_refused() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    for position, current in ((0.5, np.ones(12)), (MIDDLE[:1], np.ones(12)), (MIDDLE, np.ones(11))):
        assert np.array_equal(bench.ask(position, current.astype(np.int64)).position_rad, MIDDLE)
    assert bench.interventions() == {"refused": 3}


def test_a_hand_that_was_never_asked_properly_has_no_current() -> None:
    assert Bench(limits).ask(np.full(12, np.nan)).current.tolist() == [0] * 12


def test_a_motor_that_was_never_measured_does_not_work() -> None:
    bench = Bench(limits, angle_rad=angles((4, math.nan)))
    safe = bench.ask(MIDDLE)
    assert safe.enabled.tolist() == [motor != 4 for motor in range(12)]
    assert (safe.position_rad[4], safe.current[4]) == (0.0, 0)
    assert bench.interventions() == {"unmeasured": 1}
    bench.angle_rad = MIDDLE
    safe = bench.ask(MIDDLE)
    assert safe.enabled.all() and safe.position_rad[4] == MIDDLE[4]


def test_a_working_motor_follows_its_set_point_and_not_its_sensor() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    bench.angle_rad = angles((0, 0.1), (1, math.nan))
    safe = bench.ask(MIDDLE)
    assert np.array_equal(safe.position_rad, MIDDLE) and safe.enabled.all()
    assert bench.interventions() == {}


def test_a_stalled_motor_is_released_and_starts_again_where_it_is() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    bench.flagged[6] = True
    bench.angle_rad = angles((6, 0.3))
    safe = bench.ask(MIDDLE)
    assert safe.enabled.tolist() == [motor != 6 for motor in range(12)]
    assert (safe.position_rad[6], safe.current[6]) == (0.3, 0)
    bench.flagged[6] = False
    bench.angle_rad = angles((6, 0.2))
    assert not bench.ask(MIDDLE, after_ns=500 * MS - 1).enabled[6]
    safe = bench.ask(MIDDLE, after_ns=1)
    assert safe.enabled.all() and safe.current[6] == 20
    assert safe.position_rad[6] == pytest.approx(0.2 + 1.5e-9)
    assert bench.count("stall") == 1


def test_a_lost_motor_is_released_and_starts_again_where_it_is() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    bench.lost[6] = True
    bench.flagged[7] = True
    bench.angle_rad = angles((6, 0.3))
    safe = bench.ask(MIDDLE)
    assert safe.enabled.tolist() == [motor not in (6, 7) for motor in range(12)]
    assert (safe.position_rad[6], safe.current[6]) == (0.3, 0)
    bench.lost[6] = False
    assert bench.ask(MIDDLE).position_rad[6] == pytest.approx(0.3 + STEP_RAD)


def _release_ns(bench: Bench) -> int:
    """Stall motor 9 once, measure how long it is released, to 10 ms."""
    bench.flagged[9] = True
    assert not bench.ask(MIDDLE).enabled[9]
    bench.flagged[9] = False
    for waited in range(1, 2000):
        if bench.ask(MIDDLE, after_ns=10 * MS).enabled[9]:
            return waited * 10 * MS
    raise AssertionError("never enabled again")


def test_releases_double_up_to_a_bound_and_start_anew_after_calm() -> None:
    bench = Bench(limits, max_backoff_s=1.5)
    assert [_release_ns(bench) // MS for _ in range(4)] == [500, 1000, 1500, 1500]
    # The motor works again since `now`; a stall just before the calm is over still counts as a repetition.
    bench.ask(MIDDLE, after_ns=5000 * MS - TICK_NS - 1)
    assert _release_ns(bench) == 1500 * MS
    bench.ask(MIDDLE, after_ns=5000 * MS - TICK_NS)
    assert _release_ns(bench) == 500 * MS
    assert bench.count("stall") == 6


def test_a_flag_that_stays_is_a_new_stall_only_when_the_release_is_over() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    bench.flagged[:] = [motor == 0 for motor in range(12)]
    for after_ns, stalls in ((TICK_NS, 1), (500 * MS - 1, 1), (1, 2), (1000 * MS - 1, 2), (1, 3)):
        assert not bench.ask(MIDDLE, after_ns=after_ns).enabled[0]
        assert bench.count("stall") == stalls


def test_a_hot_board_is_released_until_it_is_cool() -> None:
    bench = Bench(limits)
    bench.ask(MIDDLE)
    expected = [motor not in (4, 5) for motor in range(12)]
    for temperature_c, enabled, counted in (
        (49.9, [True] * 12, 0),
        (50.0, expected, 1),
        (45.1, expected, 1),
        (45.0, [True] * 12, 1),
        (49.9, [True] * 12, 1),
        (1e9, expected, 2),
    ):
        bench.temperature_c[2] = temperature_c
        assert bench.ask(MIDDLE).enabled.tolist() == enabled
        assert bench.count("temperature") == counted


def test_a_board_without_a_thermometer_is_as_hot_as_the_hottest() -> None:
    bench = Bench(limits)
    bench.temperature_c[:] = (COOL_C, math.nan, COOL_C, COOL_C, COOL_C, 51.0)
    assert bench.ask(MIDDLE).enabled.tolist() == [motor not in (2, 3, 10, 11) for motor in range(12)]
    bench.temperature_c[:] = math.nan  # nothing known: nothing changes
    assert bench.ask(MIDDLE).enabled.tolist() == [motor not in (2, 3, 10, 11) for motor in range(12)]
    bench.temperature_c[:] = COOL_C
    assert bench.ask(MIDDLE).enabled.all()
    bench.temperature_c[:] = math.nan
    assert bench.ask(MIDDLE).enabled.all()


def test_options_that_would_protect_nothing_are_refused() -> None:
    for wrong in ({"pause_c": 55.0}, {"resume_c": 50.0}, {"max_backoff_s": 0.4}, {"max_current": 256}):
        with pytest.raises(ConfigError):
            parse(LimitsConfig, wrong, "cell.yaml")

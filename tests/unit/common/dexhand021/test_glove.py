"""From twenty glove angles to twelve actions: the map, the fit, and what a person's hand cannot mean."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common.dexhand021.glove import MAP, mapped_deg, motor_angles, to_actions
from common.dexhand021.glove_config import GloveUser
from common.dexhand021.glove_fit import POSTURES, fit
from common.dexhand021.glove_recording import COLUMNS, GloveError, Recording
from common.dexhand021.tables import HIGH_RAD, JOINTS
from deploy.glove import held_postures
from services.sim.glove_person import Person

NAMES = [joint.name for joint in JOINTS]
NOBODY = GloveUser()
MOTORS = arrays(np.float64, (4, 12), elements=st.floats(0, 1)).map(lambda share: share * HIGH_RAD)
SEEDS = st.integers(0, 10**6)


def angles(**degrees):
    row = np.zeros((1, 20))
    for name, value in degrees.items():
        row[0, COLUMNS.index(name)] = value
    return row


def moved(**degrees):
    """Degrees by motor of those that are not zero."""
    found = np.degrees(motor_angles(angles(**degrees), NOBODY))[0]
    return {name: round(float(value), 6) for name, value in zip(NAMES, found, strict=True) if value}


def test_columns_and_map_are_complete():
    assert len(COLUMNS) == len(set(COLUMNS)) == 20 and list(MAP) == NAMES
    used = {name for names in MAP.values() for name in names} | {"Thumb_CMC_Spread"}
    assert set(COLUMNS) - used == {"Middle_MCP_Spread"}


def test_the_map_is_the_documented_one():
    assert moved(Index_MCP_Flex=30) == {"ff_mcp": 30}
    assert moved(Ring_PIP_Flex=60, Ring_DIP_Flex=20) == {"rf_dip": 40}
    assert moved(Index_MCP_Spread=9, Ring_MCP_Spread=-6, Pinky_MCP_Spread=-15) == {"ff_spr": 10}
    assert moved(Middle_MCP_Spread=20) == {}
    assert moved(Thumb_PIP_Flex=12, Thumb_DIP_Flex=34) == {"th_mcp": 12, "th_dip": 34}
    assert moved(Thumb_CMC_Flex=25, Thumb_CMC_Spread=50) == {"th_rot": 75}


def test_a_fit_is_affine_per_motor():
    user = GloveUser(gain=tuple(range(1, 13)), offset_deg=tuple(range(12)), thumb_spread_gain=0.5)
    row = angles(Thumb_CMC_Flex=10, Thumb_CMC_Spread=8, Index_MCP_Flex=5, Thumb_DIP_Flex=-2)
    found = dict(zip(NAMES, np.degrees(motor_angles(row, user))[0], strict=True))
    assert found["th_rot"] == pytest.approx(3 * 10 + 2 + 0.5 * 8)
    assert found["ff_mcp"] == pytest.approx(6 * 5 + 5)
    assert found["th_dip"] == pytest.approx(-2)


@given(MOTORS, SEEDS)
def test_what_a_person_means_is_what_the_hand_is_told(motors, seed):
    person = Person.drawn(np.random.default_rng(seed), noise_deg=0.0)
    assert np.abs(motor_angles(person.glove_angles(motors), person.fit) - motors).max() < 1e-9


@settings(max_examples=20)
@given(MOTORS, SEEDS)
def test_the_fit_of_postures_recovers_a_person(motors, seed):
    person = Person.drawn(np.random.default_rng(seed), noise_deg=0.0)
    found = fit(postures_of(person))
    assert np.abs(np.degrees(motor_angles(person.glove_angles(motors), found.user) - motors)).max() < 0.05
    assert found.miss_deg.max() < 0.01


def postures_of(person, seed=0):
    held = held_postures(person, 3.0, np.random.default_rng(seed))
    return {recording.source: recording for recording in held}


def test_the_fit_withstands_noise():
    found = fit(postures_of(Person(noise_deg=0.5)))
    assert found.user.gain == pytest.approx([1.0] * 12, abs=0.03)
    assert found.user.offset_deg == pytest.approx([0.0] * 12, abs=1.0)


def test_a_thumb_whose_two_angles_always_go_together_is_fitted_all_the_same():
    recordings = postures_of(Person())
    flex, spread = COLUMNS.index("Thumb_CMC_Flex"), COLUMNS.index("Thumb_CMC_Spread")
    for name, recording in recordings.items():
        shown = {"thumb_forward": 40.0, "thumb_across": 72.0}.get(name, 0.0)
        recording.angles_deg[:, [flex, spread]] = shown
    user = fit(recordings).user
    assert user.gain[2] == pytest.approx(user.thumb_spread_gain, abs=1e-5)
    for name, share in (("flat", 0.0), ("thumb_forward", 0.5), ("thumb_across", 0.9)):
        found = motor_angles(recordings[name].angles_deg, user)[0, 2]
        assert found == pytest.approx(share * HIGH_RAD[2], abs=0.01)


def test_a_fit_needs_every_posture_and_a_difference_between_them():
    recordings = postures_of(Person())
    fist = recordings.pop("fist")
    with pytest.raises(GloveError) as refused:
        fit(recordings)
    assert str(refused.value) == (
        f"there is no recording of the posture fist; there must be {', '.join(POSTURES)}"
    )
    fist.angles_deg[:, COLUMNS.index("Ring_MCP_Flex")] = 2.0
    with pytest.raises(GloveError) as refused:
        fit(recordings | {"fist": fist})
    assert str(refused.value) == (
        "rf_mcp: the glove shows the same in flat and fist (within 1.4 deg): "
        "hold the postures apart, or see to the sensor"
    )


def moving(speed_deg_s, seconds=2.0, hz=60):
    """Index MCP at a steady speed from 0."""
    t_ns = np.rint(np.arange(round(seconds * hz) + 1) * 1e9 / hz).astype(np.int64)
    rows = np.zeros((len(t_ns), 20), np.float32)
    rows[:, COLUMNS.index("Index_MCP_Flex")] = speed_deg_s * t_ns / 1e9
    return Recording("moving", t_ns, rows)


def test_actions_are_where_the_hand_was_at_each_control_step():
    found = to_actions(moving(30.0), NOBODY, 3.0)
    assert found.actions.shape == (7, 12) and found.actions.dtype == np.float32
    high_deg = np.degrees(HIGH_RAD[5])
    assert found.actions[:, 5] == pytest.approx(2 * 10 * np.arange(7) / high_deg - 1, abs=1e-6)
    assert (np.delete(found.actions, 5, axis=1) == -1.0).all() and (found.cut == 0.0).all()


@pytest.mark.parametrize(("seconds", "rate_hz", "count"), [(1.0, 3.0, 4), (0.99, 3.0, 3), (1.0, 25.0, 26)])
def test_every_whole_step_of_a_recording_becomes_an_action(seconds, rate_hz, count):
    assert len(to_actions(moving(10.0, seconds, hz=100), NOBODY, rate_hz).actions) == count


def test_what_the_hand_cannot_reach_is_cut_and_counted():
    found = to_actions(moving(100.0), NOBODY, 3.0)
    assert (found.actions[3:, 5] == 1.0).all() and found.actions[2, 5] < 1.0
    assert found.cut[5] == pytest.approx(4 / 7) and found.cut.sum() == found.cut[5]


@given(arrays(np.float32, (3, 20), elements=st.floats(-180, 180, width=32)), SEEDS)
def test_no_recording_leads_beyond_the_range(rows, seed):
    user = Person.drawn(np.random.default_rng(seed)).fit
    recording = Recording("any", np.array([0, 10**8, 2 * 10**8]), rows)
    found = to_actions(recording, user, 10.0)
    assert np.abs(found.actions).max() <= 1.0
    outside = (motor_angles(rows, user) > HIGH_RAD + 1e-6) | (motor_angles(rows, user) < -1e-6)
    assert np.array_equal(found.cut, outside.mean(axis=0))
    assert mapped_deg(rows)[0].shape == (3, 12)

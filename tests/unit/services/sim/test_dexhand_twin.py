"""The twin repeats itself exactly, holds its die, feels it, notices a drop, and minds its motors."""

import mujoco
import numpy as np
import pytest

from common import geometry
from common.dexhand021.tables import HIGH_RAD
from services.sim.dexhand_twin import CUP_RAD, DexHandTwin

PARALLEL = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def twin():
    """One twin for the whole module, already used: nothing may depend on what came before."""
    used = DexHandTwin(seed=3)
    used.step(np.ones(12))
    return used


def actions(n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 12)).astype(np.float32)


def roll(twin, sequence):
    return np.array([twin.step(action) for action in sequence])


def test_same_seed_and_actions_give_the_same_states(twin):
    fresh = DexHandTwin(seed=11)
    start = twin.reset(11)
    assert np.array_equal(start.state, fresh.state)
    assert np.array_equal(start.goal, fresh.goal)
    assert np.array_equal(roll(twin, actions(12)), roll(fresh, actions(12)))
    assert not np.array_equal(start.state, twin.reset(12).state)


def test_restore_continues_exactly(twin):
    twin.reset(5)
    roll(twin, actions(4, seed=1))
    powered = np.arange(12) != 3
    twin.set_powered(powered)
    snapshot = twin.save()
    first = roll(twin, actions(8, seed=2))
    twin.reset(6)
    assert twin.powered.all()
    restored = twin.restore(snapshot)
    assert np.array_equal(twin.state, restored.state)
    assert np.array_equal(twin.powered, powered)
    assert np.array_equal(twin.goal, snapshot.observed.goal)
    assert np.array_equal(roll(twin, actions(8, seed=2)), first)


@pytest.mark.parametrize("hand", ["right", "left"])
def test_the_die_stays_in_the_still_hand(hand):
    twin = DexHandTwin(hand, seed=1)
    deepest = min((contact.dist for contact in twin.data.contact), default=0.0)
    assert deepest > -5e-4  # soft contacts, not interpenetration
    before, turned = twin.die_pose()
    assert np.allclose(before, twin.task.start_position, atol=5e-3)
    assert geometry.angle(turned, np.array(twin.task.start_rotation)) < 0.1
    twin.advance(10.0)
    after, still = twin.die_pose()
    assert np.linalg.norm(after - before) < 2e-3
    assert geometry.angle(turned, still) < 0.03
    assert twin.holding


def test_a_dropped_die_is_noticed_and_stays_near(twin):
    twin.reset(0)
    side = np.array([0.1, -0.2, 0.1])
    twin.place_die(side, PARALLEL)
    assert not np.allclose(side, twin.task.start_position)
    twin.advance(1.0)
    assert not twin.holding
    assert twin.task.dropped(twin.state)
    assert twin.task.plausible(roll(twin, actions(5))).all()
    assert twin.task.reward(twin.state, twin.goal) < -2.0


def test_random_motion_is_plausible_and_within_the_motors_range(twin):
    for seed in range(3):
        twin.reset(seed)
        states = roll(twin, actions(15, seed))
        assert twin.task.plausible(states).all()
        assert np.allclose(np.linalg.norm(states[:, 20:], axis=1), 1.0)
        assert (states[:, :12] > -0.05).all()
        assert (states[:, :12] < HIGH_RAD + 0.05).all()
        assert (states[:, 12:17] >= 0.0).all()


def test_a_pressed_fingertip_feels_the_die(twin):
    twin.reset(0)
    for _ in range(4):
        twin.step(np.tile([0.6, 0.2], 6))
    assert twin.fingertip_forces_n.max() > 0.2
    assert twin.fingertip_forces_n.max() < 30.0
    twin.place_die((0.1, -0.2, 0.1), PARALLEL)
    twin.set_targets(np.zeros(12))
    twin.advance(1.0)
    assert np.allclose(twin.fingertip_forces_n, 0.0)


def contact_forces(twin, finger):
    """Normal force, N, of each contact of a distal link, and where it is in the link's frame (n, 3)."""
    model, data = twin.model, twin.data
    link = model.body(f"{finger}_4").id
    rows = []
    for number, contact in enumerate(data.contact):
        if link in model.geom_bodyid[[contact.geom1, contact.geom2]]:
            force = np.zeros(6)
            mujoco.mj_contactForce(model, data, number, force)
            at = data.xmat[link].reshape(3, 3).T @ (contact.pos - data.xpos[link])
            rows.append((force[0], *at))
    return np.array(rows).reshape(-1, 4)


def test_a_fingertip_reads_the_normal_forces_on_its_front(twin):
    """The sensor against MuJoCo's contacts: all of those well within the pad, none of those on the back."""
    pressed = 0
    for seed in range(6):
        twin.reset(seed)
        for action in np.clip(actions(6, seed) + 0.5, -1, 1):
            twin.step(action)
            for finger, reading in enumerate(twin.fingertip_forces_n, start=1):
                force, x, y, _ = contact_forces(twin, finger).T
                assert reading <= force.sum() + 1e-9
                front = (x > 0.016) & (y > -0.006)
                assert reading >= force[front].sum() - 1e-9
                pressed += front.any()
    assert pressed > 20


def test_actions_move_no_faster_than_the_limits_gate_lets_them(twin):
    twin.reset(2)
    before = twin.targets_rad
    twin.step(np.ones(12))
    moved = twin.targets_rad - before
    assert moved.max() == pytest.approx(1.5 / 3)
    assert (np.abs(moved) <= 0.5 + 1e-9).all()
    for _ in range(5):
        twin.step(np.ones(12))
    assert np.allclose(twin.targets_rad, HIGH_RAD)


@pytest.mark.parametrize("bad", [np.full(12, np.nan), np.full(12, np.inf), np.zeros(11), np.zeros((1, 12))])
def test_bad_actions_are_refused_and_nothing_moves(twin, bad):
    before = twin.save().physics
    with pytest.raises(ValueError, match="12 finite"):
        twin.step(bad)
    assert np.array_equal(twin.save().physics, before)


def test_set_points_beyond_the_range_are_cut_and_nan_changes_nothing(twin):
    twin.reset(0)
    twin.set_targets(np.full(12, 9.0))
    assert np.array_equal(twin.targets_rad, HIGH_RAD)
    twin.set_targets(np.full(12, np.nan))
    assert np.array_equal(twin.targets_rad, HIGH_RAD)


def test_a_motor_without_power_is_limp_and_takes_no_current(twin):
    twin.reset(0)
    powered = np.ones(12, bool)
    powered[5] = False
    twin.set_powered(powered)
    twin.set_targets(np.full(12, 0.2))
    twin.advance(0.5)
    assert twin.motor_currents_ma[5] == 0.0
    assert abs(twin.joint_angles_rad[5] - CUP_RAD[5]) < 0.25
    assert twin.joint_angles_rad[7] == pytest.approx(0.2, abs=0.02)


def test_time_adds_up_however_it_is_cut(twin):
    twin.reset(0)
    for _ in range(100):
        twin.advance(0.0033)
    assert twin.data.time == pytest.approx(0.33, abs=0.002)


def test_goals_are_the_three_faces_and_do_not_disturb(twin):
    twin.reset(4)
    before = twin.state
    drawn = np.array([twin.sample_goal(seed) for seed in range(30)])
    assert np.array_equal(twin.state, before)
    faces = {int(twin.task.die.uppermost(goal[3:], twin.task.up)) for goal in drawn}
    assert faces == {2, 4, 5}
    assert np.array_equal(twin.reset(7).goal, twin.sample_goal(7))
    own = twin.task.goal(6)
    assert np.array_equal(twin.reset(7, own).goal, own)
    for bad in (own[:-1], own * np.nan):
        with pytest.raises(ValueError, match="finite"):
            twin.set_goal(bad)


def test_bodies_are_the_links_the_die_and_the_goal(twin):
    twin.reset(1)
    names, positions, quaternions = twin.bodies()
    assert names[0] == "palm"
    assert {"die", "goal", "1_4", "5_4"} <= set(names)
    assert len(set(names)) == len(names) == len(positions) == len(quaternions)
    die, goal = positions[names.index("die")], positions[names.index("goal")]
    assert np.allclose(die - goal, (0, 0, -0.13), atol=0.01)  # above, to be seen
    assert len(twin.passive) == 7
    assert len(twin.joint_velocities_rad_s) == 12

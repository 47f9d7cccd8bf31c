"""Demonstrations on the twin: repeatable, smooth, within reach, and the die stays in the hand."""

import numpy as np
import pytest

from common.dexhand021.angles import to_normalised
from common.dexhand021.glove import to_actions
from common.dexhand021.tables import HIGH_RAD
from services.sim import glove_demonstrator
from services.sim.dexhand_twin import CUP_RAD, DexHandTwin
from services.sim.glove_demonstrator import Demonstrator
from services.sim.glove_person import Person

STEPS, SEED = 12, 5


@pytest.fixture(scope="module")
def shown():
    return Demonstrator(candidates=2).demonstrate(SEED, STEPS)


def test_a_demonstration_begins_in_the_cup_and_keeps_the_die(shown):
    postures = shown.postures_rad
    assert postures.shape == (STEPS, 12) and np.array_equal(postures[0], CUP_RAD)
    assert (postures >= 0.0).all() and (postures <= HIGH_RAD).all()
    assert (np.ptp(postures, axis=0) > 0.1).sum() >= 4  # it moves
    twin = DexHandTwin()
    twin.reset(SEED + shown.takes - 1)
    before = twin.task.errors(twin.state, twin.goal)["rotation_rad"]
    for posture in postures[1:]:
        twin.step(to_normalised(posture))
    after = twin.task.errors(twin.state, twin.goal)["rotation_rad"]
    assert twin.holding and before - after == pytest.approx(shown.turned_rad, abs=0.1)


def test_the_same_seed_shows_the_same_and_another_something_else(shown):
    demonstrator = Demonstrator(candidates=2)
    other = demonstrator.demonstrate(SEED + 1, STEPS)
    again = demonstrator.demonstrate(SEED, STEPS)
    assert np.array_equal(again.postures_rad, shown.postures_rad)
    assert not np.array_equal(other.postures_rad, shown.postures_rad)


def test_a_die_that_falls_in_every_take_is_told(monkeypatch):
    monkeypatch.setattr(DexHandTwin, "holding", property(lambda _twin: False))
    with pytest.raises(RuntimeError, match="demonstration 3: the die fell in each of 20 takes"):
        Demonstrator(candidates=1).demonstrate(3, STEPS)
    with pytest.raises(ValueError, match="candidates"):
        Demonstrator(candidates=0)


def test_of_several_ideas_the_one_that_leaves_the_die_nearest_is_made():
    class Counting(Demonstrator):
        ends = ()

        def _make(self, move):
            super()._make(move)
            self.ends = (*self.ends, (-self._off() / len(move) ** 0.5, move))

    demonstrator = Counting(candidates=4)
    demonstrator._twin.reset(1)
    best = demonstrator._best_move(np.random.default_rng(0), CUP_RAD)
    assert len(demonstrator.ends) == 4
    assert best is max(demonstrator.ends, key=lambda end: end[0])[1]
    assert glove_demonstrator.SYNERGIES[0] == (0, 1, 2)


def test_a_recording_gives_back_the_demonstrated_actions(shown):
    person = Person.drawn(np.random.default_rng(1), noise_deg=0.0)
    recording = person.record(shown.postures_rad, 3.0, np.random.default_rng(2), "take")
    assert len(recording.t_ns) == 20 * (STEPS - 1) + 1 and recording.angles_deg.dtype == np.float32
    found = to_actions(recording, person.fit, 3.0)
    assert np.abs(found.actions - to_normalised(shown.postures_rad)).max() < 1e-5
    assert not found.cut.any()


def test_a_glove_is_noisy_and_a_hand_moves_smoothly():
    postures = np.array([CUP_RAD, CUP_RAD + 0.2, CUP_RAD, CUP_RAD])
    still = Person().record(postures, 3.0, np.random.default_rng(0), "take").angles_deg
    noisy = Person(noise_deg=0.3).record(postures, 3.0, np.random.default_rng(0), "take").angles_deg
    assert (noisy - still).std() == pytest.approx(0.3, rel=0.05)
    assert np.abs(np.diff(still, n=2, axis=0)).max() < 0.1 * np.ptp(still, axis=0).max()
    assert len(Person().record(postures[:1], 3.0, np.random.default_rng(0), "one").t_ns) == 1

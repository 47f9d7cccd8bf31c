"""Demonstrations are cut into episodes that show each action once, the same for the same number."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.demonstrations import Demonstrations
from common.messages import Episode, Mode, Warmup
from common.warmup import warmup_script

LENGTHS = st.lists(st.integers(1, 40), min_size=1, max_size=4)


def numbered(lengths):
    """Recordings of one-dimensional actions that are all different."""
    flat = np.linspace(-1, 1, sum(lengths), dtype=np.float32)[:, None]
    return np.split(flat, np.cumsum(lengths)[:-1])


@given(LENGTHS, st.integers(1, 15))
def test_a_round_of_episodes_shows_every_action_and_no_other(lengths, steps):
    recordings = numbered(lengths)
    shown = Demonstrations(recordings)
    count = shown.episodes(steps)
    episodes = [shown.episode(number, steps) for number in range(count)]
    assert all(episode.shape == (steps, 1) for episode in episodes)
    assert set(np.concatenate(episodes).ravel()) == set(np.concatenate(recordings).ravel())
    assert count == sum(-(-length // steps) for length in lengths)
    assert shown.samples == sum(lengths)
    assert np.array_equal(shown.episode(count, steps), episodes[0])


def test_whole_recordings_are_shown_as_they_are_and_ends_overlap():
    first, second = numbered([6, 8])
    shown = Demonstrations([first, second])
    wanted = (first[:3], first[3:], second[:3], second[3:6], second[5:])
    assert all(np.array_equal(shown.episode(n, 3), each) for n, each in enumerate(wanted))


def test_a_short_recording_is_held_at_its_end():
    shown = Demonstrations([[[0.1], [0.2]]])
    assert shown.episode(0, 4).ravel().tolist() == pytest.approx([0.1, 0.2, 0.2, 0.2])


def test_values_beyond_the_range_are_cut_and_what_is_no_action_is_refused():
    assert Demonstrations([[[5.0, -7.0]]]).episode(0, 1).tolist() == [[1.0, -1.0]]
    for bad in ([], [np.zeros((0, 2))], [np.zeros(3)], [[[0.0]], [[0.0, 0.0]]], [[[np.nan]]]):
        with pytest.raises(ValueError, match="demonstrations: "):
            Demonstrations(bad)


def episode(mode, number=1, steps=3, warmup=Warmup.NONE):
    return Episode(number, 0, np.zeros(0, np.float32), mode, warmup, steps, 5)


def test_the_script_of_a_warm_up_episode_is_that_of_its_mode():
    shown = Demonstrations(numbered([6]))
    glove = list(warmup_script(episode(Mode.GLOVE), 1, shown))
    assert np.array_equal(glove, shown.episode(1, 3))
    first = [next(warmup_script(episode(Mode.RANDOM, warmup=kind), 2, shown)) for kind in Warmup]
    assert all(action.shape == (2,) for action in first)
    assert list(warmup_script(episode(Mode.PLAN), 1, shown)) == []
    with pytest.raises(ValueError, match="demonstrations"):
        warmup_script(episode(Mode.GLOVE), 1, None)

"""Steps become whole episodes however they arrive; what is not whole is never learned from."""

import random
from dataclasses import replace

import numpy as np
import pytest

from common.messages import Header, Mode
from services.learner.recorder import PARTIAL_EPISODES, Recorder
from tests.samples import PLANT, A, G, S, step


def header(boot=PLANT):
    return Header(boot, 0, 0, True)


def steps(episode=3, length=5, **changes):
    """Steps 0 to `length`; the state of step k is k everywhere."""
    return [
        replace(
            step(k, episode=episode, steps=length, last=k == length, mode=Mode.RANDOM),
            state=np.full(S, k, np.float32),
            **changes,
        )
        for k in range(length + 1)
    ]


def record(recorder, messages, boot=PLANT):
    """The episodes that come of it."""
    return [e for e in (recorder.add(header(boot), message) for message in messages) if e is not None]


def test_an_episode_is_states_and_the_actions_between_them():
    (episode,) = record(Recorder(), steps())
    assert (episode.boot_id, episode.episode, episode.mode) == (PLANT, 3, "random")
    assert episode.states.shape == (6, S) and episode.actions.shape == (5, A)
    assert episode.states[:, 0].tolist() == [0, 1, 2, 3, 4, 5]
    # prev_action of step k + 1 is what was executed between k and k + 1
    assert episode.actions[:, 0].tolist() == [k / 16 for k in (1, 2, 3, 4, 5)]
    assert episode.goal.shape == (G,) and episode.valid.tolist() == [True] * 6
    assert {a.dtype for a in (episode.states, episode.actions, episode.goal)} == {np.dtype(np.float32)}


@pytest.mark.parametrize("seed", range(10))
def test_order_and_repetition_do_not_matter(seed):
    messages = steps() + steps()
    random.Random(seed).shuffle(messages)
    recorder = Recorder()
    (episode,) = record(recorder, messages)
    assert episode.states[:, 0].tolist() == [0, 1, 2, 3, 4, 5]
    assert record(recorder, steps()) == []  # it is known


def test_a_missing_step_holds_the_episode_back_until_it_is_recovered():
    messages = steps()
    recorder = Recorder()
    assert record(recorder, messages[:2] + messages[3:]) == []
    (episode,) = record(recorder, messages[2:3])
    assert len(episode.actions) == 5


def test_episodes_that_stay_incomplete_are_given_up_and_counted():
    recorder = Recorder()
    for number in range(PARTIAL_EPISODES + 2):
        assert record(recorder, steps(number)[:-1]) == []
    assert recorder.incomplete == 2
    assert record(recorder, steps(0)[-1:]) == []  # forgotten
    (late,) = record(recorder, steps(PARTIAL_EPISODES + 1)[-1:])  # still there
    assert late.episode == PARTIAL_EPISODES + 1


@pytest.mark.parametrize("changes", [{"mode": Mode.EVALUATE}, {"mode": Mode.IDLE}, {"waiting": True}])
def test_what_is_not_to_be_learned_from_is_passed_over(changes):
    recorder = Recorder()
    assert record(recorder, [replace(message, **changes) for message in steps()]) == []
    assert len(record(recorder, steps())) == 1


def test_the_standing_step_0_is_not_the_one_that_counts():
    messages = steps()
    standing = replace(messages[0], waiting=True, state=np.full(S, 99, np.float32))
    (episode,) = record(Recorder(), [standing, *messages, standing])
    assert episode.states[0, 0] == 0


def test_a_restarted_plant_may_use_the_same_numbers():
    recorder = Recorder()
    half = steps()[:3]
    assert record(recorder, half, boot=1) == []
    assert [e.boot_id for e in record(recorder, steps(), boot=2)] == [2]
    assert [e.boot_id for e in record(recorder, steps()[3:], boot=1)] == [1]


def test_invalid_parts_mark_their_state():
    messages = steps()
    messages[2] = replace(messages[2], part_valid=np.array([1, 0, 1], np.uint8))
    (episode,) = record(Recorder(), messages)
    assert episode.valid.tolist() == [True, True, False, True, True, True]


def test_the_goal_is_the_one_that_the_episode_ended_with():
    messages = steps()
    changed = [replace(m, goal=np.full(G, 9, np.float32), goal_seq=1) for m in messages[3:]]
    (episode,) = record(Recorder(), messages[:3] + changed)
    assert episode.goal.tolist() == [9.0] * G


def test_contradictory_or_empty_episodes_are_harmless():
    recorder = Recorder()
    assert record(recorder, steps(length=0)) == []
    beyond = [replace(m, k=m.k + 7, last=False) for m in steps(4)[:3]]
    assert record(recorder, beyond + steps(4)[3:]) == []  # as many steps as there should be, but not those
    assert [len(e.actions) for e in record(recorder, steps(4)[:3])] == [5]

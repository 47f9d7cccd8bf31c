"""Windows and runs never cross episodes nor touch invalid states; splits are by whole episodes."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.model.coordinates import RawCoordinates
from services.learner.episode import Episode
from services.learner.replay import Replay, is_held_out


def marked_episode(number, valid):
    """states[t] = (number, t), actions[t] = number + t / 1000: a row says where it comes from."""
    count = len(valid)
    states = np.stack((np.full(count, number), np.arange(count)), axis=1).astype(np.float32)
    actions = (number + np.arange(count - 1) / 1000)[:, None].astype(np.float32)
    return Episode(1, number, "random", states, actions, np.zeros(1, "f4"), np.array(valid, bool))


episodes = st.lists(st.lists(st.booleans(), min_size=1, max_size=12), min_size=1, max_size=8)


def filled(flags, holdout=0.0):
    replay = Replay(2, 1, holdout)
    for number, valid in enumerate(flags):
        replay.add(marked_episode(number, valid))
    return replay


@settings(max_examples=80, deadline=None)
@given(episodes)
def test_windows_are_exactly_the_valid_triples(flags):
    replay = filled(flags)
    expected = {
        (number, t)
        for number, valid in enumerate(flags)
        for t in range(len(valid) - 2)
        if valid[t] and valid[t + 1] and valid[t + 2]
    }
    assert replay.windows() == len(expected)
    if not expected:
        return
    windows = replay.sample(2, 200, torch.Generator().manual_seed(0))
    for offset, states in enumerate((windows.state, windows.next_state, windows.last_state)):
        assert torch.equal(states[..., 0], windows.state[..., 0])
        assert torch.equal(states[..., 1], windows.state[..., 1] + offset)
    for offset, actions in enumerate((windows.action, windows.next_action)):
        torch.testing.assert_close(
            actions[..., 0], windows.state[..., 0] + (windows.state[..., 1] + offset) / 1000
        )
    found = {(int(n), int(t)) for n, t in windows.state.flatten(0, 1).tolist()}
    assert found <= expected
    assert len(expected) > 20 or found == expected


@pytest.mark.parametrize(
    ("lost_at", "starts"), [((), (0, 1, 2, 3, 4)), ((4,), (0, 1, 2)), ((2, 3), (0,)), ((0,), ())]
)
def test_no_window_goes_on_from_a_lost_object_not_even_when_it_comes_back(lost_at, starts):
    replay = Replay(2, 1, lost=lambda states: np.isin(states[:, 1], lost_at))
    replay.add(marked_episode(0, [True] * 7))
    assert replay.windows() == len(starts)
    if starts:
        windows = replay.sample(1, 100, torch.Generator().manual_seed(0))
        assert set(windows.state[..., 1].flatten().tolist()) == set(starts)


@settings(max_examples=50, deadline=None)
@given(episodes, st.integers(1, 5))
def test_runs_are_contiguous_and_valid(flags, steps):
    runs = filled(flags).trajectories(steps, "train")
    for states, actions in zip(runs.states, runs.actions, strict=True):
        number, first = int(states[0, 0]), int(states[0, 1])
        assert states[:, 0].tolist() == [number] * (steps + 1)
        assert states[:, 1].tolist() == list(range(first, first + steps + 1))
        assert all(flags[number][first : first + steps + 1])
        assert len(actions) == steps


def test_members_draw_different_batches_and_a_seed_repeats_them():
    replay = filled([[True] * 50] * 10)
    first = replay.sample(3, 64, torch.Generator().manual_seed(0))
    again = replay.sample(3, 64, torch.Generator().manual_seed(0))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first.state[0], first.state[1])


def test_recent_share_comes_from_the_newest_episodes():
    replay = filled([[True] * 50] * 10)
    windows = replay.sample(2, 100, torch.Generator().manual_seed(0), 0.5, 3)
    assert windows.state[:, 50:, 0].min() == 7
    assert windows.state[:, :50, 0].min() == 0


def test_held_out_episodes_are_never_drawn_and_their_share_is_kept():
    replay = filled([[True] * 5] * 200, holdout=0.1)
    held = {number for number in range(200) if is_held_out(number, 0.1)}
    assert 18 <= len(held) <= 22
    assert {number % 2 for number in held} == {0, 1}
    drawn = replay.sample(1, 5000, torch.Generator().manual_seed(0)).state[0, :, 0]
    assert set(drawn.int().tolist()) == set(range(200)) - held
    assert set(replay.trajectories(2, "holdout").states[:, 0, 0].int().tolist()) == held
    assert replay.episodes == {"train": 200 - len(held), "holdout": len(held)}


def test_the_split_depends_on_the_episode_alone():
    assert [is_held_out(number, 0.0) for number in range(50)] == [False] * 50
    assert all(is_held_out(number, 0.3) for number in range(50) if is_held_out(number, 0.1))


def test_rows_survive_growth_and_are_float32():
    replay = filled([[True] * 500] * 6)
    assert replay.steps == 6 * 499
    windows = replay.sample(1, 1000, torch.Generator().manual_seed(0))
    assert windows.state.dtype == torch.float32
    assert set(windows.state[0, :, 0].int().tolist()) == set(range(6))


def test_normaliser_sees_the_valid_training_rows_only():
    replay = filled([[True, True, False, True], [True] * 4])
    normaliser = replay.normaliser()
    assert float(normaliser.input_mean[1]) == pytest.approx((0 + 0 + 1 + 2) / 4)  # of states that were left
    assert float(normaliser.delta_mean[1]) == 1.0
    assert float(normaliser.delta_std[1]) == 1.0  # constant: counts as 1


def turning(flip_from=None):
    """One number and a quaternion that turns a little each step, its sign changed from a step on."""
    half = np.arange(20) * 0.05
    states = np.stack([np.arange(20), np.cos(half), np.sin(half), 0 * half, 0 * half], axis=1)
    states[flip_from:, 1:] *= 1 if flip_from is None else -1
    flags, zero = np.ones(20, bool), np.zeros((19, 1), "f4")
    return Episode(1, 0, "random", states.astype("f4"), zero, np.zeros(1, "f4"), flags)


def deltas_of(episode, quaternions):
    replay = Replay(5, 1, 0.0, RawCoordinates(5, 1, quaternions))
    replay.add(episode)
    return replay.normaliser()


def test_a_flipped_quaternion_does_not_inflate_the_statistics_of_change():
    plain, raw = deltas_of(turning(), ()), deltas_of(turning(10), ())
    flipped = deltas_of(turning(10), (slice(1, 5),))
    change = np.diff(turning().states, axis=0)
    change[10:, 1:] *= -1  # as the targets are: the second of each pair on the side of the first
    np.testing.assert_allclose(flipped.delta_mean, change.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(flipped.delta_std[1:3], change.std(axis=0)[1:3], rtol=1e-4)
    assert float(raw.delta_std[1]) > 5 * float(flipped.delta_std[1])
    unflipped = deltas_of(turning(), (slice(1, 5),))
    assert torch.equal(unflipped.delta_std, plain.delta_std)
    assert turning(10).states[10, 1] < 0  # what is stored stays as it was measured

"""What has been executed between two requests: consecutive steps alone."""

import numpy as np
import pytest

from services.planner.executed import Executed


def shown(*steps):
    """Each step (k,) or, not measured, (k, None): its state is k, the action that led to it k / 100."""
    executed = Executed()
    for k, *state in steps:
        measured = None if state else np.full(3, k, np.float32)
        executed.add(k, np.full(2, k / 100, np.float32), measured)
    return executed


def told(executed):
    states, actions = executed.take()
    assert (states.dtype, actions.dtype, states.shape[1:]) == (np.float32, np.float32, (3,))
    return states[:, 0].tolist(), (100 * actions[:, 0]).round().tolist()


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([(0,)], ([0], [])),
        ([(0,), (0,), (1,), (2,)], ([0, 1, 2], [1, 2])),
        ([(0,), (1,), (3,), (4,)], ([3, 4], [4])),
        ([(0,), (1, None), (2,), (3,)], ([2, 3], [3])),
    ],
)
def test_steps_without_a_gap_are_told(steps, expected):
    assert told(shown(*steps)) == expected


def test_each_step_is_told_once_and_the_newest_state_begins_the_next():
    executed = shown((0,), (1,))
    assert told(executed) == ([0, 1], [1])
    for k in (2, 3):
        executed.add(k, np.full(2, k / 100, np.float32), np.full(3, k, np.float32))
    assert told(executed) == ([1, 2, 3], [2, 3])


def test_no_more_is_kept_than_a_planner_could_use():
    states, _ = told(shown(*((k,) for k in range(80))))
    assert states == list(range(51, 80))

import numpy as np
import pytest
import torch

from bench.baselines.controller import Trajectory
from bench.baselines.inputs import Inputs
from bench.baselines.replay import Priorities, Replay
from tests.unit.bench.baselines.toys import PointMass

TASK = PointMass()


def numbered(first, steps, goal):
    """States, actions and rewards that tell which step of which episode they are."""
    k = np.arange(first, first + steps + 1, dtype=np.float32)
    return Trajectory(
        np.stack((k, -k), 1), np.stack((k, k), 1)[:-1] / 100, k[:-1] / 10, np.full(2, goal, np.float32), True
    )


def test_windows_never_cross_episodes_and_keep_their_goal():
    replay = Replay(TASK, steps=3)
    assert [
        replay.add(numbered(0, 5, 1)),
        replay.add(numbered(10, 2, 2)),
        replay.add(numbered(20, 3, 3)),
    ] == [
        3,
        0,
        1,
    ]
    drawn = replay.windows(torch.arange(len(replay)))
    np.testing.assert_array_equal(
        drawn.states[..., 0], [[0, 1, 2, 20], [1, 2, 3, 21], [2, 3, 4, 22], [3, 4, 5, 23]]
    )
    np.testing.assert_allclose(drawn.actions[..., 1] * 100, [[0, 1, 2, 20], [1, 2, 3, 21], [2, 3, 4, 22]])
    np.testing.assert_allclose(drawn.rewards[..., 0] * 10, drawn.actions[..., 1] * 100)
    assert drawn.goal[:, 0].tolist() == [1, 1, 1, 3]


def test_the_replay_grows_beyond_its_first_room():
    replay = Replay(TASK, steps=1)
    for number in range(30):
        replay.add(numbered(100 * number, 50, number))
    assert len(replay) == 1500
    assert replay.windows(torch.tensor([1499])).states[:, 0, 0].tolist() == [2949, 2950]


def test_windows_are_drawn_in_proportion_to_their_priorities():
    priorities = Priorities()
    priorities.add(4)
    priorities.update(torch.tensor([0, 1, 2, 3]), torch.tensor([0.0, 1.0, 2.0, 5.0]))
    drawn = priorities.sample(8000, torch.Generator().manual_seed(0))
    shares = torch.bincount(drawn, minlength=4) / 8000
    # Three deviations of a binomial share.
    for share, wanted in zip(shares.tolist(), (0, 1 / 8, 2 / 8, 5 / 8), strict=True):
        assert share == pytest.approx(wanted, abs=3 * np.sqrt(wanted * (1 - wanted) / 8000) + 1e-9)


def test_a_new_window_gets_the_largest_priority_so_far():
    priorities = Priorities()
    priorities.add(2)
    assert priorities.values.tolist() == [1, 1]
    priorities.update(torch.tensor([0]), torch.tensor([4.0]))
    priorities.update(torch.tensor([0]), torch.tensor([2.0]))
    priorities.add(1)
    assert priorities.values.tolist() == [2, 1, 4]
    priorities.update(torch.tensor([2]), torch.tensor([0.5]))
    priorities.forget_largest()
    priorities.add(1)
    assert priorities.values.tolist() == [2, 1, 0.5, 2]


def test_inputs_measure_a_goal_as_the_state_that_attains_it():
    inputs = Inputs(TASK)
    states = torch.tensor([[0.0, 1.0], [2.0, 1.0]])
    inputs.fit(states)
    # Means 1 and 1, deviations 1 and 0: the second is taken as 0.01, and what is far away is cut at 5.
    seen = inputs(torch.tensor([2.0, 1.02]), torch.tensor([0.5, 2.0]))
    np.testing.assert_allclose(seen, [1.0, 2.0, -0.5, 5.0], rtol=1e-5)

from dataclasses import replace

import numpy as np
import pytest

from common.messages import Chunk, Episode, Fallback, Header, Mode, Sample, Warmup
from deploy.scores import EpisodeTrace, Scoreboard
from tests.unit.deploy.scripted_cell import TASK, step_message

STEPS = 4


def episode(number=3):
    return Episode(number, 0, np.zeros(0, np.float32), Mode.PLAN, Warmup.NONE, STEPS, 1)


def steps(boot_id=1, seq=0, skip=(), **changes):
    messages = [step_message(episode(), k, **changes) for k in range(STEPS + 1) if k not in skip]
    return [Sample("control/step", Header(boot_id, seq + i, 0, True), m) for i, m in enumerate(messages)]


def chunk(seq, commit, number=3, snapshot_id="new"):
    empty = np.zeros(TASK.state_dim, np.float32)
    actions = np.zeros((3, TASK.action_dim), np.float32)
    message = Chunk(1, number, 0, 0, commit, actions, 0, 0, 1, empty, empty, -1.0, snapshot_id, 1.0)
    return Sample("control/chunk", Header(2, seq, 0, True), message)


def scored(samples, chunks=(), assumed_commit=None):
    trace = EpisodeTrace(3, assumed_commit)
    for each in chunks:
        trace.add_chunk(each)
    ended = [trace.add(sample) for sample in samples]
    assert ended[-1] and not any(ended[:-1])
    return trace.score(TASK)


def test_the_return_is_the_sum_of_rewards_over_the_states_after_each_action():
    row = scored(steps())
    states = [np.full(TASK.state_dim, np.float32(0.01 * k), np.float64) for k in range(1, STEPS + 1)]
    goal = np.zeros(TASK.goal_dim)
    assert row["return"] == pytest.approx(sum(TASK.env_reward(state, goal) for state in states), abs=1e-6)
    assert row["error_mean_finger_m"] == pytest.approx(
        TASK.errors(states[-1], goal)["mean_finger_m"], abs=1e-6
    )
    assert row["success_paper"] is False and row["steps"] == STEPS


def test_waiting_steps_duplicates_and_the_time_before_a_restart_do_not_count():
    first = steps()[:3]
    again = steps(boot_id=7, seq=5)
    waiting = Sample("control/step", Header(7, 4, 0, True), step_message(episode(), 0, waiting=True))
    assert scored([*first, waiting, *again[:2], again[1], *again[2:]]) == scored(steps())


def test_an_episode_with_a_gap_has_no_return():
    row = scored(steps(skip=(2,)))
    assert "return" not in row and row["missing_steps"] == 1
    assert "error_mean_finger_m" in row


def seen(*ks):
    """An episode in which only the states of these k were measured in all parts."""
    samples = steps()
    blind = np.zeros_like(samples[0].message.part_valid)
    return [
        sample
        if sample.message.k in ks
        else replace(sample, message=replace(sample.message, part_valid=blind))
        for sample in samples
    ]


def test_states_that_nobody_measured_earn_nothing_and_are_counted():
    """The mean of the others stands for them: 2 of 4 seen."""
    row = scored(seen(0, 1, 4))
    states = [np.full(TASK.state_dim, np.float32(0.01 * k), np.float64) for k in (1, 4)]
    earned = sum(float(TASK.env_reward(state, np.zeros(TASK.goal_dim))) for state in states)
    assert row["return"] == pytest.approx(2 * earned, abs=1e-6)
    assert row["unseen_steps"] == 2 and scored(steps())["unseen_steps"] == 0


def test_an_end_that_nobody_measured_is_judged_by_the_last_whole_state_and_is_no_success():
    row = scored(seen(0, 1, 2))
    expected = TASK.errors(np.full(TASK.state_dim, np.float32(0.02), np.float64), np.zeros(TASK.goal_dim))
    assert row["error_mean_finger_m"] == pytest.approx(float(expected["mean_finger_m"]), abs=1e-6)
    assert row["success_paper"] is False and row["success_env"] is False
    blind = scored(seen(0))
    assert "return" not in blind and blind["unseen_steps"] == STEPS


def test_late_is_beyond_the_commit_of_its_own_chunk():
    samples = steps(chunk_seq=8, chunk_offset=2)
    assert scored(samples, [chunk(8, commit=2)])["late"] == STEPS
    assert scored(samples, [chunk(8, commit=3)])["late"] == 0
    assert scored(samples, [chunk(8, commit=2, number=4)])["late"] == 0  # of another episode
    assert scored(samples, assumed_commit=2)["late"] == STEPS
    assert scored(samples, [chunk(8, commit=3)])["snapshot_id"] == "new"


def test_fallbacks_are_counted_apart():
    row = scored(steps(fallback=Fallback.HOLD))
    assert (row["held"], row["fallback_hold"], row["fallback_start"]) == (STEPS, STEPS, 0)


def test_the_scoreboard_shows_the_newest_evaluation_alone():
    board = Scoreboard()
    row = {"mode": "evaluate", "planned": 4, "late": 1, "held": 0, "error_mean_finger_m": 0.002}
    for index, success in [(0, False), (1, False), (0, True), (1, False)]:
        board.add({**row, "index": index, "success_paper": success, "return": -1.0})
    fields = board.fields()
    assert fields["success_rate"] == 0.5
    assert fields["late_share"] == 0.25
    assert fields["eval_error_mm"] == pytest.approx(2.0)

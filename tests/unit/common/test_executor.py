"""The action buffer is addressed by step: late plans give what is left of them, and absence is survived."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.executor import ActionBuffer
from common.messages import Fallback
from tests.samples import PLANT, A, chunk


def buffer(start_steps=0, hold_steps=3):
    made = ActionBuffer(A, start_steps, hold_steps)
    made.reset(PLANT, 3, 0)
    return made


def run(made, first, count):
    """(action, chunk, offset, fallback, late) of steps first, first + 1, ..."""
    rows = []
    for k in range(first, first + count):
        executed = made.take(k)
        assert executed.action.shape == (A,) and np.ptp(executed.action) == 0
        rows.append(
            (
                float(executed.action[0]),
                executed.chunk_seq,
                executed.chunk_offset,
                executed.fallback.value,
                executed.late,
            )
        )
    return rows


def test_a_chunk_is_executed_by_step_and_its_tail_counts_as_late():
    made = buffer()
    assert made.offer(chunk(2, (0.25, 0.5, 0.75)), 9, 0) == ""
    assert run(made, 2, 3) == [
        (0.25, 9, 0, "none", False),
        (0.5, 9, 1, "none", False),
        (0.75, 9, 2, "none", True),
    ]
    assert made.counts == {"planned": 3, "late": 1}


def test_a_late_chunk_contributes_its_future_part():
    made = buffer()
    assert made.offer(chunk(0, (0.0, 0.125, 0.25, 0.375)), 4, 2) == ""
    assert not made.covers(1)
    assert run(made, 2, 2) == [(0.25, 4, 2, "none", True), (0.375, 4, 3, "none", True)]


@pytest.mark.parametrize(
    ("offered", "reason"),
    [
        ({"plant_boot_id": PLANT + 1}, "other boot"),
        ({"episode": 4}, "other episode"),
        ({"goal_seq": 1}, "other goal"),
        ({"first_k": 0}, "all late"),
        ({"first_k": 30, "values": ()}, "empty"),
    ],
)
def test_a_chunk_for_something_else_is_refused_and_counted(offered, reason):
    made = buffer()
    made.offer(chunk(5, (0.25, 0.5)), 1, 5)
    assert made.offer(chunk(**offered), 2, 5) == reason
    assert made.refused == {reason: 1}
    assert [row[:2] for row in run(made, 5, 2)] == [(0.25, 1), (0.5, 1)]


def test_an_older_chunk_never_replaces_a_newer_one():
    made = buffer()
    made.offer(chunk(0, (0.25, 0.25)), 5, 0)
    assert made.offer(chunk(0, (0.5, 0.5)), 5, 0) == "older than the one in use"
    assert made.offer(chunk(0, (0.5, 0.5)), 4, 0) == "older than the one in use"
    assert run(made, 0, 1)[0][:2] == (0.25, 5)


def test_a_planner_that_restarts_counts_from_zero_again():
    made = buffer()
    made.offer(chunk(0, (0.25, 0.25)), 500, 0, sender=1)
    assert made.offer(chunk(0, (0.5, 0.5)), 0, 0, sender=2) == ""
    assert run(made, 0, 2) == [(0.5, 0, 0, "none", False), (0.5, 0, 1, "none", False)]


def test_the_newest_chunk_wins_from_its_first_step_on():
    made = buffer()
    made.offer(chunk(0, (0.25,) * 6), 1, 0)
    made.offer(chunk(2, (0.5, 0.5)), 2, 0)
    assert [row[0] for row in run(made, 0, 5)] == [0.25, 0.25, 0.5, 0.5, 0.5]
    assert made.counts["hold"] == 1  # the old chunk's tail behind the new one is gone


def test_with_nothing_left_the_hand_holds_and_then_relaxes():
    made = buffer(hold_steps=2)
    made.offer(chunk(0, (0.75,)), 1, 0)
    assert [(row[0], row[3]) for row in run(made, 0, 5)] == [
        (0.75, "none"),
        (0.75, "hold"),
        (0.75, "hold"),
        (0.0, "relax"),
        (0.0, "relax"),
    ]
    assert made.counts == {"planned": 1, "late": 0, "hold": 2, "relax": 2}


def test_a_plan_ends_the_hold_and_the_next_hold_begins_anew():
    made = buffer(hold_steps=1)
    made.offer(chunk(0, (0.5,)), 1, 0)
    run(made, 0, 2)
    made.offer(chunk(2, (0.25,)), 2, 2)
    assert [(row[0], row[3]) for row in run(made, 2, 3)] == [(0.25, "none"), (0.25, "hold"), (0.0, "relax")]


def test_start_zero_executes_x_zeros_and_does_not_call_them_a_hold():
    made = buffer(start_steps=2)
    made.offer(chunk(2, (0.5,)), 1, 0)
    assert [(row[0], row[3]) for row in run(made, 0, 4)] == [
        (0.0, "start"),
        (0.0, "start"),
        (0.5, "none"),
        (0.5, "hold"),
    ]


def test_a_new_goal_drops_the_plans_and_holds_what_was_commanded():
    made = buffer()
    made.offer(chunk(0, (0.5,) * 4), 1, 0)
    run(made, 0, 1)
    made.change_goal(PLANT, 3, 1)
    assert not made.covers(1)
    assert run(made, 1, 1)[0] == (0.5, -1, -1, Fallback.HOLD.value, False)
    assert made.offer(chunk(2, (0.25,) * 4), 2, 2) == "other goal"
    assert made.offer(chunk(2, (0.25,) * 4, goal_seq=1), 3, 2) == ""


def test_a_new_episode_forgets_the_last_command_and_the_count_of_chunks():
    made = buffer()
    made.offer(chunk(0, (0.5,) * 4), 9, 0)
    run(made, 0, 1)
    made.reset(PLANT, 4, 0)
    assert run(made, 0, 1)[0][0] == 0.0
    assert made.offer(chunk(1, episode=4), 0, 1) == ""


def test_covered_and_committed_are_told_apart():
    made = buffer()
    made.offer(chunk(3, (0.5,) * 3), 1, 0)  # commit is 2
    assert [made.covers(k) for k in range(2, 7)] == [False, True, True, True, False]
    assert [made.covers(k, committed=True) for k in range(2, 7)] == [False, True, True, False, False]


def test_a_mirror_predicts_the_hold_of_what_was_really_executed():
    made = buffer()
    made.executed(np.full(A, 0.5, np.float32))
    assert made.peek(0, 5)[:, 0].tolist() == [0.5, 0.5, 0.5, 0.0, 0.0]


actions = st.lists(st.sampled_from([-1.0, -0.5, 0.25, 0.5, 1.0]), max_size=6)
offers = st.tuples(st.integers(0, 4), actions, st.integers(1, 3))


@given(
    start=st.integers(0, 3),
    hold=st.integers(0, 3),
    script=st.lists(st.lists(offers, max_size=2), max_size=10),
    count=st.integers(0, 12),
)
def test_peek_shows_what_take_will_do(start, hold, script, count):
    made = buffer(start, hold)
    seq = 0
    for k, arriving in enumerate(script):
        for ahead, values, commit in arriving:
            made.offer(chunk(k + ahead, values, commit=commit), seq, k)
            seq += 1
        made.take(k)
    k = len(script)
    foreseen = made.peek(k, count)
    assert np.array_equal(foreseen, made.peek(k, count))  # looking changes nothing
    taken = [made.take(index).action for index in range(k, k + count)]
    assert np.array_equal(foreseen, np.array(taken, np.float32).reshape(count, A))


@given(script=st.lists(st.tuples(st.integers(0, 3), st.integers(1, 6)), min_size=1, max_size=10))
def test_every_step_is_executed_once_and_accounted_for(script):
    made = buffer()
    for k, (ahead, length) in enumerate(script):
        made.offer(chunk(k + ahead, (0.5,) * length), k, k)
        made.take(k)
    counts = made.counts
    assert counts["planned"] + counts["hold"] + counts["relax"] == len(script)


def test_a_mirror_that_follows_a_holding_plant_predicts_when_it_relaxes():
    mirror = ActionBuffer(A, 0, hold_steps=3)
    mirror.reset(1, 2, 3)
    last = np.full(A, 0.5, np.float32)
    mirror.follow(4, last, held=False)
    for k in (5, 6):
        mirror.follow(k, last, held=True)
    assert np.array_equal(mirror.peek(6, 3), [last, 0 * last, 0 * last])  # held at 4, 5, 6: then relaxed

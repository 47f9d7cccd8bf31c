"""The planner's service: what is planned when, from which state, and what becomes of the plan."""

from dataclasses import replace

import numpy as np
import pytest

from common.messages import Mode
from common.topics import METRICS, SNAPSHOT, STEP
from services.planner.config import PlannerConfig
from tests.samples import LEARNER, METRICS_0, PLANT, A, S, snapshot, step
from tests.unit.services.drivers import H, Planner


def asked(planner):
    return [(r.source_k, r.first_k, len(r.committed)) for r in planner.requests]


def test_without_a_model_nothing_is_planned_and_with_it_the_newest_state_is():
    planner = Planner(model=False)
    planner.show(STEP, step(0, waiting=True))
    assert (planner.requests, planner.state) == ([], "waiting for a model")
    planner.show(SNAPSHOT, snapshot(b"first"), LEARNER)
    assert (planner.requests, planner.state) == ([], "waiting for a model")
    planner.work("load")
    assert asked(planner) == [(0, 0, 0)]
    assert (planner.state, planner.fields["snapshots"]) == ("planning", 1)


def test_the_first_plan_is_for_the_waiting_step_and_the_next_starts_behind_its_committed_part():
    planner = Planner()
    planner.show(STEP, step(0, waiting=True))
    assert asked(planner) == [(0, 0, 0)]
    (first,) = planner.work()
    assert (first.first_k, first.commit, len(first.actions)) == (0, 2, H)
    planner.show(STEP, step(0))
    assert asked(planner)[1:] == [(0, 2, 2)]
    assert np.array_equal(planner.requests[1].committed, first.actions[:2])


def test_a_plan_is_made_every_x_steps_and_none_for_steps_beyond_the_end():
    planner = Planner()
    planner.show(STEP, step(0, waiting=True))
    planner.work()
    for k in range(11):
        planner.show(STEP, step(k))
        while planner.queue:
            planner.work()
    assert asked(planner) == [(0, 0, 0), (0, 2, 2), (2, 4, 2), (4, 6, 2), (6, 8, 2)]
    assert [c.first_k for c in planner.chunks] == [0, 2, 4, 6, 8]
    for earlier, later in zip(planner.chunks[1:], planner.requests[2:], strict=False):
        assert np.array_equal(later.committed, earlier.actions[:2])


def test_one_plan_at_a_time_and_the_next_from_the_newest_state():
    planner = Planner()
    planner.show(STEP, step(0, waiting=True))
    planner.work()
    planner.show(STEP, step(0))
    for k in (1, 2, 3):
        planner.show(STEP, step(k))
    assert len(planner.queue) == 1
    planner.work()
    assert asked(planner) == [(0, 0, 0), (0, 2, 2), (3, 5, 2)]
    # Late: at step 3 the plant has taken the tail of the first plan already; at 4 it has the plan for 2.
    expected = [planner.chunks[0].actions[3], planner.chunks[1].actions[2]]
    assert np.array_equal(planner.requests[2].committed, expected)


def test_with_start_zero_the_first_plan_starts_behind_x_zeros():
    planner = Planner(start="zero")
    planner.show(STEP, step(0))
    assert asked(planner) == [(0, 2, 2)]
    assert not planner.requests[0].committed.any()


def test_what_the_plant_holds_is_predicted_when_there_is_no_plan():
    planner = Planner()
    planner.show(STEP, step(4, prev_action=np.full(A, 0.5, np.float32)))
    assert asked(planner) == [(4, 6, 2)]
    assert np.array_equal(planner.requests[0].committed, np.full((2, A), 0.5, np.float32))


def test_a_plan_for_an_old_goal_is_counted_and_not_published():
    planner = Planner()
    planner.show(STEP, step(0))
    new_goal = np.full_like(step().goal, 0.5)
    planner.show(STEP, step(1, goal_seq=1, goal=new_goal))
    assert planner.work() == []
    assert (planner.fields["stale_plans"], planner.fields["plans"]) == (1, 1)
    request = planner.requests[-1]  # planned at once, for the new goal
    assert (request.goal_seq, request.source_k, request.first_k) == (1, 1, 3)
    assert np.array_equal(request.goal, new_goal)
    # What was planned for the old goal is dropped by the plant as well: it holds.
    assert np.array_equal(request.committed, np.repeat(step(1).prev_action[None], 2, axis=0))
    assert [c.goal_seq for c in planner.work()] == [1]


@pytest.mark.parametrize("changes", [{"episode": 4}, {}])
def test_another_episode_or_a_restarted_plant_begins_anew(changes):
    planner = Planner()
    planner.show(STEP, step(0))
    planner.work()
    boot = PLANT if changes else PLANT + 1
    planner.show(STEP, step(0, waiting=True, **changes), boot)
    assert asked(planner)[-1] == (0, 0, 0)
    (sent,) = planner.work()
    assert (sent.plant_boot_id, sent.episode) == (boot, changes.get("episode", 3))


def test_a_chunk_says_what_it_is_for_and_where_it_came_from():
    planner = Planner(chunk="x")
    planner.show(STEP, step(2), t_ns=77)
    (sent,) = planner.work(milliseconds=30)
    named = (sent.plant_boot_id, sent.episode, sent.goal_seq, sent.first_k, sent.commit)
    assert named == (PLANT, 3, 0, 4, 2)
    assert (sent.source_k, sent.source_t_ns, sent.predicted_k) == (2, 77, 6)
    assert (sent.snapshot_id, sent.solve_ms, sent.score) == ("first", 30.0, -1.0)
    assert sent.actions.shape == (2, A)


@pytest.mark.parametrize("changes", [{"mode": Mode.RANDOM}, {"mode": Mode.GLOVE}, {"mode": Mode.IDLE}])
def test_only_planned_episodes_are_planned(changes):
    planner = Planner()
    planner.show(STEP, step(0, **changes))
    assert planner.requests == []


def test_the_last_step_asks_for_nothing():
    planner = Planner()
    planner.show(STEP, step(3, last=True))
    assert planner.requests == []


def test_a_refused_snapshot_is_counted_and_shown_and_the_old_model_kept():
    planner = Planner()
    planner.show(SNAPSHOT, snapshot(b"broken"), LEARNER)
    planner.work("load")
    assert planner.fields["refused_snapshots"] == 1
    assert planner.state == "snapshot refused: ValueError: not a snapshot"
    planner.show(STEP, step(0))
    assert [c.snapshot_id for c in planner.work()] == ["first"]
    planner.show(SNAPSHOT, snapshot(b"second"), LEARNER)
    planner.work("load")
    assert (planner.state, planner.fields["snapshots"]) == ("ready", 2)


def test_a_new_snapshot_is_loaded_beside_planning_and_used_from_the_next_plan_on():
    planner = Planner()
    planner.show(STEP, step(0))
    planner.show(SNAPSHOT, snapshot(b"second"), LEARNER)
    assert [(job.name, job.lane) for job in planner.queue] == [("plan", "main"), ("load", "load")]
    assert [c.snapshot_id for c in planner.work()] == ["first"]
    planner.show(STEP, step(2))  # a plant that moves does not wait for the loading
    planner.work("load")
    assert [c.snapshot_id for c in planner.work()] == ["first"]
    planner.show(STEP, step(4))
    assert [c.snapshot_id for c in planner.work()] == ["second"]


def test_of_snapshots_that_come_while_one_is_loaded_only_the_newest_is():
    planner = Planner()
    for name in (b"second", b"third", b"fourth"):
        planner.show(SNAPSHOT, snapshot(name), LEARNER)
    assert len(planner.queue) == 1
    planner.work("load")
    planner.work("load")
    assert (planner.fields["snapshots"], len(planner.queue)) == (3, 0)
    planner.show(STEP, step(0))
    assert [c.snapshot_id for c in planner.work()] == ["fourth"]


def test_a_plant_that_stands_still_waits_for_the_model_that_is_being_loaded():
    planner = Planner()
    planner.show(SNAPSHOT, snapshot(b"second"), LEARNER)
    planner.show(STEP, step(0, waiting=True))
    assert planner.requests == []
    planner.work("load")
    assert [c.snapshot_id for c in planner.work()] == ["second"]


def test_a_plan_that_fails_is_counted_shown_and_made_again():
    planner = Planner()
    planner.solver.fails = True
    planner.show(STEP, step(0, waiting=True))
    assert planner.work() == []
    assert (planner.fields["failed_plans"], planner.state) == (1, "plan failed: RuntimeError: no luck")
    planner.solver.fails = False
    assert planner.turn(12) == [] and len(planner.requests) == 1  # half a second has not passed yet
    planner.turn(1)
    assert [c.first_k for c in planner.work()] == [0]  # the plant stands waiting and sends nothing more
    assert planner.state == "ready"


def test_a_plan_of_which_every_candidate_diverged_is_counted_and_sent_as_invalid():
    planner = Planner()
    for k in (0, 2, 4, 6):
        planner.show(STEP, step(k))
        planner.work()
    assert planner.fields["diverged_plans"] == 1
    assert planner.valid == [True, True, True, False]
    assert [c.score for c in planner.chunks] == [-1.0, -2.0, -3.0, -1e30]  # finite, as the wire wants it


def episode_of_plans(planner, number, milliseconds):
    """One episode of ten steps, each plan of which takes so long; returns the x that it was planned with."""
    for k in range(10):
        planner.show(STEP, step(k, episode=number))
        while planner.queue:
            planner.work(milliseconds=milliseconds)
    return planner.fields["x"]


def test_x_auto_follows_the_measured_solve_time_from_one_episode_to_the_next():
    planner = Planner(PlannerConfig(declared_solve_ms=90.0, horizon=8), steps_per_plan="auto")
    planner.show(STEP, step(0))
    assert asked(planner) == [(0, 3, 3)]  # 25 Hz, 90 ms as declared
    taken = [episode_of_plans(planner, number, 30) for number in range(4, 20)]
    assert taken[0] == 3  # too few plans to go by
    assert taken[-1] == 1
    assert planner.requests[-1].commit == 1
    later = [episode_of_plans(planner, number, 1000) for number in range(20, 24)]
    assert later[-1] == 7  # never as far as the plan itself


def test_a_plant_that_asks_again_is_answered_again():
    """The first chunk may have got lost: chunks are neither kept nor repeated by the bus."""
    planner = Planner()
    for asking in (1, 2):
        planner.show(STEP, step(0, waiting=True))
        planner.work()
        assert asked(planner) == [(0, 0, 0)] * asking


def test_a_plant_that_stands_waits_for_the_snapshot_that_the_learner_has_told_of():
    planner = Planner()
    planner.show(METRICS, replace(METRICS_0, snapshot_id="on its way"))
    planner.show(STEP, step(0, waiting=True))
    assert asked(planner) == []
    planner.turn(100)  # four seconds: lost, then, and the old one has to do
    assert asked(planner) == [(0, 0, 0)]


def test_synchronous_plans_from_the_state_itself_and_only_when_the_plant_waits():
    planner = Planner(synchronous=True)
    for k in (0, 2):
        planner.show(STEP, step(k, waiting=True))
        planner.work()
        planner.show(STEP, step(k))
        planner.show(STEP, step(k + 1))
    assert asked(planner) == [(0, 0, 0), (2, 2, 0)]


def test_training_episodes_explore_one_in_so_many_and_evaluations_never():
    config = PlannerConfig(explore_std=0.3, explore_every=2)

    def noise(**changes):
        planner = Planner(config)
        planner.show(STEP, step(0, **changes))
        assert planner.requests[0].noise.shape == (10, A)
        return planner.requests[0].noise

    assert noise(episode=4).any()
    assert np.array_equal(noise(episode=4), noise(episode=4))
    assert not noise(episode=5).any()
    assert not noise(episode=4, mode=Mode.EVALUATE).any()


def test_the_declared_solve_time_is_the_job_s_latency():
    planner = Planner(PlannerConfig(declared_solve_ms=12.5))
    planner.show(STEP, step(0))
    assert planner.queue[0].latency_ns == 12_500_000


def test_the_newest_step_wins_within_one_turn():
    planner = Planner()
    for k in range(4):
        planner.send(STEP, replace(step(k), state=np.full(S, k / 10, np.float32)))
    planner.turn()
    assert asked(planner) == [(3, 5, 2)]
    assert planner.requests[0].state[0] == np.float32(0.3)

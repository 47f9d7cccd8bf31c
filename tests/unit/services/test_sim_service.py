"""The plant's service: episodes on its own clock, plans by step index, and nothing that can stop it."""

from collections import Counter

import numpy as np
import pytest

from common.messages import Fallback, Mode, Warmup
from common.topics import ACK, CHUNK, EPISODE, PLANT_FRAME
from common.warmup import WarmupActions
from tests.samples import (
    PLANNER,
    PLANT,
    TASK,
    A,
    G,
    S,
    ack,
    chunk,
    episode,
    frame,
)
from tests.unit.services.drivers import Plant


def of(steps):
    return [(s.k, s.waiting, s.last) for s in steps]


def actions(plant):
    return [round(float(c.action[0]), 4) for c in plant.commands if c.action.size]


def test_with_start_plan_it_stands_until_a_plan_covers_step_0_and_says_so_once():
    plant = Plant()
    assert of(plant.begin()) == [(0, True, False)]
    assert [plant.turn(1) for _ in range(3)] == [[], [], []]
    assert [c.reset for c in plant.commands] == [True]
    plant.plan(values=(0.25, 0.5))
    assert plant.turn() == []  # the plan is there, but it moves at the control rate only
    assert of(plant.turn(1)) == [(0, False, False)]
    assert actions(plant) == [0.25]
    assert plant.steps[0].state[0] == plant.steps[1].state[0] == np.float32(0.01)


def test_a_plant_that_stands_asks_again_every_half_second_until_a_plan_is_there():
    plant = Plant()
    plant.begin()
    asked = [len(plant.turn(1)) for _ in range(30)]
    assert [tick for tick, count in enumerate(asked, start=1) if count] == [12, 24]  # at 25 Hz
    assert of(plant.steps) == [(0, True, False)] * 3


def test_a_goal_that_changes_while_it_stands_is_asked_for():
    plant = Plant()
    plant.begin()
    plant.send(EPISODE, episode(goal_seq=1, goal=np.full(G, 0.5, np.float32)))
    (told,) = plant.turn(1)
    assert (told.k, told.waiting, told.goal_seq) == (0, True, 1)


def test_with_start_zero_it_executes_x_zeros_and_then_what_was_planned():
    plant = Plant(start="zero")
    assert plant.begin() == []
    plant.plan(first_k=2, values=(0.75,) * 4)
    for _ in range(4):
        plant.turn(1)
    assert of(plant.steps) == [(k, False, False) for k in range(4)]
    assert actions(plant) == [0.0, 0.0, 0.75, 0.75]
    assert [s.fallback for s in plant.steps] == [Fallback.NONE, Fallback.START, Fallback.START, Fallback.NONE]


def test_a_step_tells_state_and_action_as_executed_and_where_it_came_from():
    plant = Plant(hold_steps=1)
    plant.begin()
    plant.send(CHUNK, chunk(0, (0.25, 0.5)), boot=PLANNER, seq=40)
    for _ in range(5):
        plant.turn(1)
    told = [
        (s.k, float(s.prev_action[0]), s.chunk_seq, s.chunk_offset, s.fallback.value, s.first)
        for s in plant.steps[1:]
    ]
    assert told == [
        (0, 0.0, -1, -1, "none", True),
        (1, 0.25, 40, 0, "none", False),
        (2, 0.5, 40, 1, "none", False),
        (3, 0.5, -1, -1, "hold", False),
        (4, 0.0, -1, -1, "relax", False),
    ]
    assert [round(float(s.state[0]), 4) for s in plant.steps[1:]] == [0.01, 0.02, 0.03, 0.04, 0.05]
    assert all(s.part_valid.tolist() == [1] * len(TASK.groups) for s in plant.steps)
    assert plant.fields["held_steps"] == 3


def test_random_episodes_run_as_fast_as_the_device_answers_and_no_faster():
    plant = Plant()
    plant.begin(mode=Mode.RANDOM, warmup=Warmup.UNIFORM, seed=7)
    for _ in range(3):
        plant.turn()  # no tick: only a frame
    assert [s.k for s in plant.steps] == [0, 1, 2, 3]
    plant.answers = False
    plant.turn()
    assert plant.turn(1) == plant.turn(5) == []
    expected = WarmupActions("uniform", A, 7, 3)
    sent = [c.action for c in plant.commands if c.action.size]
    assert all(np.array_equal(action, next(expected)) for action in sent)
    assert all(np.array_equal(s.prev_action, a) for s, a in zip(plant.steps[1:], sent, strict=False))
    assert plant.fields["warmup_steps"] == 5 and plant.fields["missed_ticks"] == 0


@pytest.mark.parametrize("mode", [Mode.RANDOM, Mode.PLAN])
def test_the_last_step_closes_the_episode_and_nothing_follows(mode):
    plant = Plant()
    plant.begin(mode=mode, steps=3)
    plant.plan(values=(0.5,) * 3)
    for _ in range(8):
        plant.turn(1)
    moved = [s for s in plant.steps if not s.waiting]
    assert of(moved) == [(0, False, False), (1, False, False), (2, False, False), (3, False, True)]
    assert len([c for c in plant.commands if c.action.size]) == 3
    assert np.array_equal(moved[-1].prev_action, plant.commands[-1].action)
    assert moved[-1].state[0] == np.float32(0.04)  # what the last action led to
    assert plant.service.report().state == "episode finished"


def test_finished_episodes_wait_for_their_acknowledgement_evaluations_do_not():
    plant = Plant()
    for number, mode in ((3, Mode.RANDOM), (4, Mode.EVALUATE), (5, Mode.RANDOM)):
        plant.begin(number=number, mode=mode, steps=1)
        plant.plan(values=(0.5,), episode=number)
        for _ in range(3):
            plant.turn(1)
    assert plant.fields["unacknowledged"] == 2
    plant.send(ACK, ack(2))
    plant.turn()
    assert plant.fields["unacknowledged"] == 2
    plant.send(ACK, ack(3))
    plant.turn()
    assert plant.fields["unacknowledged"] == 1
    plant.send(ACK, ack(5, boot=PLANT - 1))  # stored when this plant was another process
    plant.turn()
    assert plant.fields["unacknowledged"] == 0


def running(**control):
    plant = Plant(**control)
    plant.begin()
    plant.plan(values=(0.25,) * 9)
    plant.turn(1)
    plant.turn(1)
    return plant


def test_a_new_goal_in_mid_episode_drops_the_plan_and_the_hand_holds():
    plant = running()
    goal = np.full(G, 0.5, np.float32)
    plant.send(EPISODE, episode(goal_seq=1, goal=goal))
    plant.plan(first_k=2, values=(-0.5,) * 5)  # made for the old goal
    (told,) = plant.turn(1)
    assert (told.goal_seq, told.k) == (1, 2)
    assert np.array_equal(told.goal, goal)
    assert np.array_equal(plant.commands[-2].goal, goal) and not plant.commands[-2].reset
    assert actions(plant) == [0.25, 0.25, 0.25]
    assert plant.fields["refused_other_goal"] == 1
    plant.plan(first_k=3, values=(0.75,), goal_seq=1)
    assert plant.turn(1)[0].fallback is Fallback.HOLD
    assert actions(plant)[-1] == 0.75


def test_a_goal_that_changes_before_the_plant_has_answered_is_not_lost():
    plant = Plant()
    plant.answers = False
    goal = np.full(G, 0.5, np.float32)
    plant.send(EPISODE, episode())
    plant.turn()
    plant.send(EPISODE, episode(goal_seq=1, goal=goal))
    plant.turn()
    assert [(c.reset, c.goal.size) for c in plant.commands] == [(True, 0), (False, G)]


def test_an_old_goal_and_a_repeated_assignment_change_nothing():
    plant = running()
    plant.send(EPISODE, episode(goal_seq=1, goal=np.full(G, 0.5, np.float32)))
    plant.turn(1)
    before = len(plant.commands)
    plant.send(EPISODE, episode(goal_seq=0, goal=np.zeros(G, np.float32)))
    plant.turn()
    plant.send(EPISODE, episode(goal_seq=1))
    plant.turn()
    assert len(plant.commands) == before
    assert plant.turn(1)[0].goal_seq == 1


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"plant_boot_id": PLANT + 1}, "refused_other_boot"),
        ({"episode": 2}, "refused_other_episode"),
        ({"goal_seq": 1}, "refused_other_goal"),
        ({"first_k": 0, "values": (0.5, 0.5)}, "refused_all_late"),
    ],
)
def test_a_chunk_for_something_else_is_refused_and_counted(wrong, reason):
    plant = running()
    plant.plan(**({"first_k": 2, "values": (-1.0,) * 5} | wrong))
    plant.turn(1)
    assert actions(plant) == [0.25, 0.25, 0.25]
    assert plant.fields[reason] == plant.fields["refused_chunks"] == 1


def test_the_plans_of_a_restarted_planner_are_taken():
    plant = Plant()
    plant.begin()
    plant.send(CHUNK, chunk(values=(0.25,) * 9), boot=PLANNER, seq=900)
    plant.turn(1)
    plant.send(CHUNK, chunk(1, (0.75,) * 5), boot=PLANNER + 1, seq=0)
    plant.turn(1)
    assert actions(plant) == [0.25, 0.75]


def test_missed_ticks_are_counted_and_no_step_is_skipped():
    plant = running()
    (told,) = plant.turn(4)
    assert told.k == 2
    assert plant.turn(1)[0].k == 3
    assert plant.fields["missed_ticks"] == 3
    assert plant.fields["control_steps"] == 4


def test_late_steps_are_those_beyond_the_first_x_of_their_chunk():
    plant = running()  # x is 2
    for _ in range(3):
        plant.turn(1)
    assert plant.fields["late_steps"] == 3


def test_another_episode_abandons_the_running_one():
    plant = running()
    assert of(plant.begin(number=4)) == [(0, True, False)]
    assert plant.commands[-1].reset
    assert plant.fields["abandoned_episodes"] == 1
    plant.plan(values=(0.75,) * 5)
    plant.turn(1)
    assert plant.fields["refused_other_episode"] == 1
    assert plant.steps[-1].waiting


def test_an_episode_whose_goal_does_not_fit_the_task_is_refused():
    plant = running()
    plant.send(EPISODE, episode(4, goal=np.zeros(G - 1, np.float32)))
    assert [s.episode for s in plant.turn(1)] == [3]
    assert plant.fields["refused_episodes"] == 1
    assert plant.fields["abandoned_episodes"] == 0


def test_the_reset_command_carries_seed_and_goal():
    plant = Plant()
    plant.begin(seed=123, goal=np.full(G, 0.5, np.float32))
    (reset,) = plant.commands
    assert (reset.reset, reset.seed, reset.action.size) == (True, 123, 0)
    assert np.array_equal(reset.goal, np.full(G, 0.5, np.float32))


def test_synchronous_control_waits_for_a_plan_at_every_step_that_none_covers():
    plant = Plant(synchronous=True)
    plant.begin(steps=4)
    plant.plan(0, (0.25, 0.5, 0.75))  # x is 2: the third action is not committed
    for _ in range(4):
        plant.turn(1)
    assert of(plant.steps) == [(0, True, False), (0, False, False), (1, False, False), (2, True, False)]
    plant.plan(2, (-0.25, -0.5))
    for _ in range(4):
        plant.turn(1)
    assert of(plant.steps[4:]) == [(2, False, False), (3, False, False), (4, False, True)]
    assert actions(plant) == [0.25, 0.5, -0.25, -0.5]


def test_idle_ends_what_is_going_on_and_a_wrong_frame_starts_nothing():
    plant = running()
    plant.send(EPISODE, episode(9, mode=Mode.IDLE, steps=0))
    assert plant.turn(1) == []
    plant.send(PLANT_FRAME, frame(reset=True))
    assert [plant.turn(1) for _ in range(3)] == [[], [], []]
    assert plant.service.report().state == "waiting for an episode"


def test_a_dropped_object_is_told():
    plant = Plant()
    plant.answers = False
    plant.send(EPISODE, episode())
    plant.turn()
    plant.send(PLANT_FRAME, frame(reset=True, dropped=True))
    assert [s.dropped for s in plant.turn()] == [True]
    assert plant.steps[0].state.shape == (S,)


def test_every_field_of_the_report_is_a_number_from_the_start():
    fields = Plant().fields
    assert Counter(type(value) for value in fields.values()) == {float: len(fields)}
    assert fields["episode"] == -1

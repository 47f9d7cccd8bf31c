"""hand_io's service: moves only while armed, and tells the same story as the simulated hand."""

from dataclasses import replace

import numpy as np
import pytest

from common.bus import Inbox
from common.cell import ControlConfig, SharedConfig
from common.hand_messages import ArmRequest, ArmWish, Drive, Link
from common.messages import Chunk, Episode, Fallback, Header, Mode, PlantFrame, Warmup
from common.service import Publish, ToPort
from common.topics import ARM_REQUEST, CHUNK, EPISODE, PLANT_FRAME, STEP
from services.sim.service import SimService
from tests.unit.services.hand_io.hand import CODEC, FRAME_NS, POSE, TASK, DrivenService

GOAL = TASK.goal(4).astype(np.float32)


def episode(number=3, mode=Mode.PLAN, steps=6, goal_seq=0):
    return Episode(number, goal_seq, GOAL, mode, Warmup.UNIFORM, steps, 7)


def chunk(first_k, values, boot=11, number=3, goal_seq=0):
    return Chunk(
        plant_boot_id=boot,
        episode=number,
        goal_seq=goal_seq,
        first_k=first_k,
        commit=2,
        actions=np.repeat(np.array(values, np.float32)[:, None], 12, axis=1),
        source_k=max(0, first_k - 2),
        source_t_ns=0,
        predicted_k=first_k,
        predicted_state=np.zeros(24, np.float32),
        predicted_std=np.zeros(24, np.float32),
        score=0.0,
        snapshot_id="s",
        solve_ms=1.0,
    )


def begun(hand, **changes):
    """Bring an episode to the point where the hand stands ready."""
    hand.send(EPISODE, episode(**changes))
    for _ in range(10):
        hand.turn()
    return hand


def test_unarmed_it_moves_nothing_whatever_comes():
    hand = DrivenService()
    hand.send(EPISODE, episode(mode=Mode.RANDOM))
    hand.send(CHUNK, chunk(0, [0.5] * 6))
    for _ in range(50):
        hand.turn(1)
    assert hand.commands == [] and hand.steps == []
    assert hand.words == "hold: not armed"


def test_armed_it_goes_to_the_start_waits_for_the_die_and_then_for_a_plan():
    hand = DrivenService().armed()
    assert hand.drives == [Drive.HOLD]
    hand.pose = replace(POSE, position=np.array([-0.1, 0.0, 0.1], np.float32))
    begun(hand)
    assert hand.drives == [Drive.HOLD, Drive.FOLLOW] and hand.steps == []
    assert hand.words == "running: waiting for the die in the hand"
    hand.pose = POSE
    hand.turn()
    hand.turn()
    assert [(s.k, s.waiting) for s in hand.steps] == [(0, True)]
    assert np.array_equal(hand.steps[0].goal, GOAL)


def test_the_die_that_is_still_being_laid_in_keeps_the_episode_waiting():
    hand = DrivenService(settle_s=0.2).armed()
    hand.send(EPISODE, episode())
    for number in range(40):
        hand.pose = replace(POSE, position=np.array([0.05 + 0.005 * (number % 2), 0.0, 0.14], np.float32))
        hand.turn()
    assert hand.steps == []
    for _ in range(12):
        hand.turn()
    assert hand.steps


def test_while_the_die_is_waited_for_the_driver_hears_often_enough_not_to_let_go():
    hand = DrivenService(hold_s=0.4).armed()
    hand.pose = replace(POSE, position=np.array([-0.1, 0.0, 0.1], np.float32))
    hand.send(EPISODE, episode())
    heard = []
    for number in range(100):
        before = len(hand.commands)
        hand.turn()
        heard += [number] * (len(hand.commands) - before)
    assert np.diff(heard).max() * FRAME_NS <= 0.2e9


def running(**control):
    hand = DrivenService(ControlConfig(**({"rate_hz": 10, "steps_per_plan": 2} | control))).armed()
    begun(hand)
    hand.send(CHUNK, chunk(0, [0.25] * 4))
    hand.turn(1)
    hand.turn(1)
    return hand


@pytest.mark.parametrize(
    ("wrong", "state", "drive"),
    [
        ({"link": Link.BUS_OFF}, "fault: bus off", Drive.OFF),
        ({"overheated": np.eye(6, dtype=np.uint8)[2]}, "fault: too hot: index", Drive.OFF),
        ({"link": Link.DOWN, "error": "no such device"}, "hold: no bus: no such device", Drive.OFF),
        ({"age_ms": np.full(6, 1500, np.float32)}, "hold: silent: thumb palm index", Drive.OFF),
        ({"counts": {"starts": 1.0}}, "hold: a board has restarted", Drive.OFF),
    ],
)
def test_what_is_wrong_ends_the_episode_and_comes_back_only_into_hold(wrong, state, drive):
    hand = running()
    good, boot = hand.frame, hand.service.boot_id
    hand.turn(**wrong)
    assert hand.words.startswith(state) and hand.drives[-1] is drive
    commands, steps = len(hand.commands), len(hand.steps)
    assert not hand.arm().accepted or "restarted" in state
    if "restarted" not in state:
        for _ in range(3):
            hand.turn(1)
        hand.frame = replace(good, counts=hand.frame.counts, drive=hand.frame.drive)
        for _ in range(20):
            hand.turn(1)
        assert hand.words == "hold: not armed"
        assert (len(hand.commands), len(hand.steps)) == (commands, steps)
        assert hand.arm().accepted
    for _ in range(10):
        hand.turn()
    assert (hand.steps[-1].k, hand.steps[-1].waiting, hand.service.boot_id) == (0, True, boot + 1)


def test_a_silent_planner_means_hold_then_no_torque_and_it_goes_on_when_plans_come():
    hand = running(hold_steps=2)
    while len(hand.steps) < 8:
        hand.turn(1)
    told = [step.fallback for step in hand.steps[3:]]
    assert told == [Fallback.NONE, Fallback.NONE, Fallback.NONE, Fallback.HOLD, Fallback.HOLD][:5]
    hand = running(hold_steps=1)
    for _ in range(4):
        hand.turn(1)
    assert hand.drives[-1] is Drive.OFF
    for _ in range(6):
        hand.turn()
    assert hand.words.startswith("relax")


def test_a_disarmed_hand_stays_where_it_is():
    hand = running()
    assert hand.arm(ArmWish.DISARM).state == "hold"
    assert hand.drives[-1] is Drive.HOLD
    commands = len(hand.commands)
    for _ in range(20):
        hand.turn(1)
    assert len(hand.commands) == commands
    assert hand.arm(ArmWish.DISARM).accepted  # who insists wants it limp
    assert hand.drives[commands:] == [Drive.OFF]


def test_two_wishes_to_stop_that_come_together_make_the_hand_limp():
    hand = running()
    for _ in range(2):
        hand.send(ARM_REQUEST, ArmRequest(ArmWish.DISARM))
    hand.turn()
    assert hand.drives[-1] is Drive.OFF and len(hand.replies) == 3


def test_what_the_limits_made_of_an_action_is_what_is_published():
    hand = running()
    limited = np.zeros(12, np.uint8)
    limited[4] = 1
    target = hand.frame.target_rad.copy()
    target[4] = 0.3
    (step,) = hand.turn(1, limited=limited, target_rad=target)
    assert step.prev_action[4] == pytest.approx(2 * 0.3 / 1.2998 - 1, abs=1e-3)
    assert np.allclose(np.delete(step.prev_action, 4), 0.25)


def test_parts_tell_their_age_and_validity_and_keep_their_last_value():
    hand = running()
    ages = np.array([2, 2, 350, 2, 2, 2], np.float32)
    forces = np.array([1, 0, 1, 1, 1], np.uint8)
    good = hand.steps[-1].state
    hand.pose = None
    angles = hand.frame.angle_rad * np.float32(0.5)
    (step,) = hand.turn(1, age_ms=ages, force_valid=forces, angle_rad=angles)
    assert step.part_valid.tolist() == [0, 0, 1, 1]
    assert step.part_age_ms[0] == 350 and step.part_age_ms[2] == pytest.approx(20, abs=1)
    assert np.array_equal(step.state[4:6], good[4:6])  # of the stale board
    assert np.allclose(step.state[:4], angles[:4])


# --- the same story as in simulation --------------------------------------------------------------


class Simulated:
    """The simulated hand with the same inputs; its device shows what the driven one showed."""

    def __init__(self, control):
        config = SharedConfig(task="die", control=control)
        self.service = SimService(config, TASK, 11)
        self.inbox = Inbox(CODEC, self.service.inputs)
        self.steps, self._seq = [], 0

    def send(self, topic, message, boot=22):
        self._seq += 1
        self.inbox.sink(topic)(topic.key, CODEC.encode(Header(boot, self._seq, 0, True), message))

    def turn(self, ticks, state, goal):
        self.inbox.collect(0, ticks)
        outputs = self.service.step(0, self.inbox)
        self.steps += [o.message for o in outputs if isinstance(o, Publish) and o.topic is STEP]
        for output in outputs:
            if isinstance(output, ToPort):
                self.send(PLANT_FRAME, PlantFrame(state, goal, False, output.message.reset))


@pytest.mark.parametrize("start", ["plan", "zero"])
@pytest.mark.parametrize("hold_steps", [1, 30])
def test_both_hands_publish_the_same_for_the_same_script(start, hold_steps):
    control = ControlConfig(rate_hz=10, steps_per_plan=2, start=start, hold_steps=hold_steps)
    hand, sim = DrivenService(control).armed(), Simulated(control)
    script = {
        0: (EPISODE, episode(steps=12)),
        12: (CHUNK, chunk(0, [0.25, 0.5, -0.5])),
        15: (CHUNK, chunk(2, [0.75, -0.75], boot=99)),
        17: (EPISODE, episode(steps=12, goal_seq=1)),
        18: (CHUNK, chunk(4, [0.1, 0.2], goal_seq=1)),
        19: (CHUNK, chunk(5, [0.3, 0.4, 0.5], goal_seq=1)),
        40: (EPISODE, episode(4, Mode.EVALUATE, steps=2)),
        60: (CHUNK, chunk(0, [0.0, 0.1], number=4)),
    }
    for moment in range(70):
        for each in (hand, sim):
            if moment in script:
                each.send(*script[moment])
        ticks = int(10 < moment < 40 or moment > 55)
        sent = hand.turn(ticks)
        state = sent[-1].state if sent else np.zeros(24, np.float32)
        sim.turn(ticks, state, GOAL)
    assert [tell(step) for step in hand.steps] == [tell(step) for step in sim.steps]
    assert len(hand.steps) > 15


def tell(step):
    """Everything but what the sensors say."""
    return (
        step.episode,
        step.goal_seq,
        step.k,
        step.steps,
        step.mode,
        [round(float(a), 4) for a in step.prev_action],
        step.goal.tolist(),
        step.chunk_offset,
        step.fallback,
        (step.first, step.last, step.waiting, step.dropped),
        step.part_valid.tolist(),
    )

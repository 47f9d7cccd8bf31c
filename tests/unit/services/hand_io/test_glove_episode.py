"""hand_io replays a glove as it follows a planner: through the limits, telling what the hand really did."""

from dataclasses import replace

import numpy as np

from common.cell import ControlConfig
from common.demonstrations import Demonstrations
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import HIGH_RAD, MOTORS
from common.messages import Episode, Fallback, Mode, Warmup
from common.topics import EPISODE
from services.hand_io.limits import Reason, Sensed
from services.hand_io.limits_config import LimitsConfig
from services.hand_io.set_points import SetPoints
from tests.unit.services.hand_io.hand import FRAME_NS, DrivenService
from tests.unit.services.hand_io.kinematic import KinematicTwin

RATE_HZ, TURNS = 5, 10  # a tick every ten frames of 20 ms
STEPS = 12
LIMITS = LimitsConfig()


class LimitedService(DrivenService):
    """With the set points and limits of the driver, and joints that follow them."""

    def __init__(self, demonstrations):
        super().__init__(ControlConfig(rate_hz=RATE_HZ, steps_per_plan=2), demonstrations=demonstrations)
        self.points = SetPoints(LIMITS, DexHandConfig(), 10**9)
        self.twin = KinematicTwin()
        self.sent = []

    @property
    def sensed(self):
        angle = self.twin.joint_angles_rad
        return Sensed(angle, np.full(6, 30.0), np.zeros(MOTORS, np.bool_))

    def turn(self, ticks=0, **changes):
        nobody = np.zeros(MOTORS, np.bool_)
        safe = self.points.step(self.now_ns + FRAME_NS, self.sensed, nobody)
        self.sent.append(safe.position_rad)
        self.twin.set_powered(safe.enabled)
        self.twin.set_targets(safe.position_rad)
        self.twin.advance(FRAME_NS / 1e9)
        self.frame = replace(
            self.frame,
            drive=self.points.drive,
            angle_rad=self.twin.joint_angles_rad.astype(np.float32),
            target_rad=safe.position_rad.astype(np.float32),
            enabled=safe.enabled.astype(np.uint8),
            limited=self.points.limited.astype(np.uint8),
        )
        return super().turn(ticks, **changes)

    def _obey(self, command):
        self.commands.append(command)
        self.points.command(self.now_ns, command, self.sensed)


def replayed(actions, number=0):
    """A whole episode of the glove, armed and at the control rate."""
    hand = LimitedService(None if actions is None else Demonstrations([actions])).armed()
    empty = np.zeros(0, np.float32)
    hand.send(EPISODE, Episode(number, 0, empty, Mode.GLOVE, Warmup.NONE, STEPS, 5))
    for turn in range(TURNS * (STEPS + 5)):
        hand.turn(int(turn % TURNS == 0))
    return hand


def slow():
    """Actions (STEPS, 12) that the limits have nothing against."""
    wave = np.sin(np.arange(STEPS) / 4)[:, None]
    actions = np.full((STEPS, MOTORS), -0.3, np.float32) + 0.1 * wave.astype(np.float32)
    actions[:, 3] = -0.9  # little spread
    return actions


def test_an_episode_executes_each_action_at_the_control_rate_and_waits_for_nobody():
    hand = replayed(slow())
    assert [step.k for step in hand.steps] == list(range(STEPS + 1))
    assert {step.mode for step in hand.steps} == {Mode.GLOVE}
    assert not any(step.waiting for step in hand.steps) and hand.steps[-1].last
    assert {(step.chunk_seq, step.fallback) for step in hand.steps} == {(-1, Fallback.NONE)}
    followed = [c.action for c in hand.commands if c.action.size][-STEPS:]
    assert np.array_equal(followed, slow())
    assert np.allclose([step.prev_action for step in hand.steps[2:]], slow()[1:], atol=1e-3)


def test_a_bad_glove_value_is_clamped_and_what_the_hand_did_is_published():
    wild = np.where(np.arange(STEPS)[:, None] % 2, 50.0, -50.0) * np.ones((1, MOTORS))
    hand = replayed(wild)
    assert len(hand.steps) == STEPS + 1
    sent = np.array(hand.sent[1:])
    assert (sent >= 0.0).all() and (sent <= HIGH_RAD).all() and hand.twin.within_limits
    assert np.abs(np.diff(sent, axis=0)).max() <= LIMITS.rate_rad_s * FRAME_NS / 1e9 + 1e-6
    assert hand.points.counts[Reason.RATE] > 0 and hand.points.counts[Reason.INTERFERENCE] > 0
    executed = np.array([step.prev_action for step in hand.steps[1:]])
    assert np.abs(executed).max() <= 1.0
    # From end to end within a fifth of a second no joint but the spread gets: it says how far it came.
    asked = np.clip(wild, -1.0, 1.0)
    assert np.abs(executed - asked)[:, 5].min() > 0.3


def test_unarmed_it_moves_nothing_and_without_recordings_it_refuses():
    hand = LimitedService(Demonstrations([slow()]))
    empty = np.zeros(0, np.float32)
    hand.send(EPISODE, Episode(0, 0, empty, Mode.GLOVE, Warmup.NONE, STEPS, 5))
    for _ in range(50):
        hand.turn(1)
    assert hand.commands == [] and hand.steps == []
    hand = replayed(None)
    assert hand.steps == [] and hand.service.report().fields["refused_episodes"] == 1

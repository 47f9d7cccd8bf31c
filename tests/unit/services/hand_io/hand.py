"""hand_io's service with a driver that does at once what it is told; and frames and poses to show it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from common.built import codec_for
from common.bus import Inbox
from common.cell import ControlConfig
from common.dexhand021.angles import to_normalised, to_radians
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import HIGH_RAD, Hand
from common.hand_messages import (
    ArmRequest,
    ArmWish,
    Drive,
    HandCommand,
    HandFrame,
    Link,
    ObjectPose,
    PoseSource,
)
from common.messages import Header
from common.service import Publish, ToPort
from common.task import get_die_task, get_task
from common.task.die import TASK_OF
from common.topics import ARM_REQUEST, HAND_FRAME, OBJECT_POSE, STEP
from services.hand_io.config import HandIoConfig, HandIoProcess
from services.hand_io.service import HandIoService

TASK, CODEC = get_task("die"), codec_for("die")
FRAME_NS = 20_000_000

GOOD_FRAME = HandFrame(
    t_ns=0,
    link=Link.UP,
    drive=Drive.OFF,
    angle_rad=(HIGH_RAD / 2).astype(np.float32),
    target_rad=(HIGH_RAD / 2).astype(np.float32),
    enabled=np.zeros(12, np.uint8),
    limited=np.zeros(12, np.uint8),
    current_ma=np.zeros(12, np.float32),
    flags=np.zeros(12, np.uint8),
    force_n=np.full(5, 0.5, np.float32),
    force_valid=np.ones(5, np.uint8),
    temperature_c=np.full(6, 30.0, np.float32),
    temperature_valid=np.ones(6, np.uint8),
    age_ms=np.full(6, 2.0, np.float32),
    rate_hz=np.full(6, 50.0, np.float32),
    overheated=np.zeros(6, np.uint8),
    counts={"starts": 0.0},
    error="",
)
POSE = ObjectPose(
    position=np.array([0.05, 0.0, 0.14], np.float32),
    rotation=np.array([1.0, 0.0, 0.0, 0.0], np.float32),
    covariance=np.zeros((6, 6), np.float32),
    quality=1.0,
    label_posterior=np.eye(24, dtype=np.float32)[0],
    source=PoseSource.TWIN,
)


class DrivenService:
    """Steps the service; `turn` lets 20 ms pass and shows it a frame, with a tick every `rate_hz`."""

    def __init__(self, control=None, hand=Hand.RIGHT, demonstrations=None, **options):
        quick = {"recover_s": 0.0, "reset_s": 0.1, "settle_s": 0.0, "hold_s": 1.0}
        config = HandIoProcess(
            task=TASK_OF[hand],
            hand=DexHandConfig(hand=hand),
            control=control or ControlConfig(rate_hz=10, steps_per_plan=2),
            hand_io=HandIoConfig(**{**quick, **options}),
        )
        self.service = HandIoService(config, get_die_task(TASK_OF[hand], hand), 11, demonstrations)
        self.inbox = Inbox(CODEC, self.service.inputs)
        self.now_ns, self._seq = 10**18, Counter()
        self.frame, self.pose = GOOD_FRAME, POSE
        self.steps, self.commands, self.replies = [], [], []

    def send(self, topic, message, boot=22, *, seq=None, t_ns=None, valid=True):
        number = self._seq[topic.key] if seq is None else seq
        self._seq[topic.key] = number + 1
        header = Header(boot, number, self.now_ns if t_ns is None else t_ns, valid)
        self.inbox.sink(topic)(topic.key, CODEC.encode(header, message))

    def turn(self, ticks=0, **changes):
        """One step of the service; returns the steps that it published."""
        self.now_ns += FRAME_NS
        self.frame = replace(self.frame, t_ns=self.now_ns, **changes)
        self.send(HAND_FRAME, self.frame)
        if self.pose is not None:
            self.send(OBJECT_POSE, self.pose)
        self.inbox.collect(self.now_ns, ticks)
        outputs = self.service.step(self.now_ns, self.inbox)
        sent = [o.message for o in outputs if isinstance(o, Publish) and o.topic is STEP]
        self.steps += sent
        for output in outputs:
            if isinstance(output, ToPort) and isinstance(output.message, HandCommand):
                self._obey(output.message)
            elif isinstance(output, ToPort):
                self.replies.append(output.message)
        return sent

    def _obey(self, command):
        """As the driver would within the control period, without limits."""
        self.commands.append(command)
        self.frame = replace(self.frame, drive=command.drive)
        if command.drive is Drive.FOLLOW:
            target = to_radians(command.action).astype(np.float32)
            self.frame = replace(self.frame, target_rad=target, angle_rad=target)

    def lay(self, position):
        """Move the die, turned as it is, to `position` (3,)."""
        self.pose = replace(self.pose, position=position)

    def arm(self, wish=ArmWish.ARM):
        self.send(ARM_REQUEST, ArmRequest(wish, self.now_ns + 2 * FRAME_NS))
        self.turn()
        return self.replies[-1]

    def armed(self):
        self.turn()
        assert self.arm().accepted
        return self

    @property
    def drives(self):
        return [command.drive for command in self.commands]

    @property
    def words(self):
        return self.service.report().state


def normalised(value_rad):
    return to_normalised(np.full(12, value_rad))

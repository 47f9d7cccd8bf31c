"""Looks after an emulated hand: tells where the die is, and lays it in as a person would."""

from __future__ import annotations

import numpy as np

from common.bus import Inbox, Input
from common.camera_messages import TwinTruth
from common.hand_messages import ObjectPose, PoseSource, TwinCommand, TwinFrame
from common.messages import Float32, Mode
from common.service import Output, Publish, Report, ToPort
from common.topics import EPISODE, OBJECT_POSE, TWIN_COMMAND, TWIN_FRAME, TWIN_TRUTH
from services.sim.emulator_config import EmulatorProcess

NS_PER_S = 1e9
STILL_RAD, STILL_NS = 0.02, 300_000_000  # a hand that has moved no more for so long stands still
_CERTAIN = np.diag(np.full(6, 1e-8)).astype(np.float32)
_ONE_LABEL: Float32 = np.eye(24, dtype=np.float32)[0]


class EmulatorService:
    """The die is laid in after a new episode or a drop, once the hand stands still with torque on."""

    name = "emulator"
    inputs = (Input(EPISODE, newest=True, wake=True), Input(TWIN_FRAME, wake=True))

    def __init__(self, config: EmulatorProcess, boot_id: int) -> None:
        self.boot_id = boot_id
        self.period_ns: int | None = None
        self._publishes = config.pose_source is PoseSource.TWIN
        self._lay_after_ns = round(config.emulator.lay_after_s * NS_PER_S)
        self._episode = -1
        self._wanted_ns: int | None = None  # since when the die should be laid in
        self._still_from: tuple[int, Float32] | None = None
        self._frame: TwinFrame | None = None
        self._laid = 0
        self._drops = 0

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Pass the pose on, and look whether the die is where it should be."""
        for sample in inbox.take(EPISODE):
            new = sample.message.episode != self._episode and sample.message.mode is not Mode.IDLE
            self._episode = sample.message.episode
            if new:
                self._wanted_ns = now_ns
        out: list[Output] = []
        for sample in inbox.take(TWIN_FRAME):
            out += self._follow(now_ns, sample.message)
        return out

    def _follow(self, now_ns: int, frame: TwinFrame) -> list[Output]:
        if self._frame is not None and self._frame.holding and not frame.holding:
            self._drops += 1
        self._frame = frame
        if not frame.holding and self._wanted_ns is None:
            self._wanted_ns = now_ns
        out: list[Output] = [self._pose(frame) if self._publishes else _truth(frame)]
        return [*out, ToPort("twin", TWIN_COMMAND, TwinCommand(True))] if self._lays(now_ns, frame) else out

    def _lays(self, now_ns: int, frame: TwinFrame) -> bool:
        still = self._stands_still(now_ns, frame)
        if self._wanted_ns is None or now_ns - self._wanted_ns < self._lay_after_ns or not still:
            return False
        self._wanted_ns = None
        self._laid += 1
        return True

    def _stands_still(self, now_ns: int, frame: TwinFrame) -> bool:
        moved = self._still_from is None or np.abs(frame.q_rad - self._still_from[1]).max() > STILL_RAD
        if moved or not frame.powered.all():
            self._still_from = now_ns, frame.q_rad
        return self._still_from is not None and now_ns - self._still_from[0] >= STILL_NS

    def _pose(self, frame: TwinFrame) -> Output:
        pose = ObjectPose(
            position=frame.position,
            rotation=frame.rotation,
            covariance=_CERTAIN,
            quality=1.0,
            label_posterior=_ONE_LABEL,
            source=PoseSource.TWIN,
        )
        return Publish(OBJECT_POSE, pose, t_ns=frame.t_ns)

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving."""
        return []

    def report(self) -> Report:
        """Counts since the start of the process."""
        frame = self._frame
        if frame is None:
            return Report("starting")
        torque = int(frame.powered.sum())
        state = f"{torque} of 12 motors with torque, die {'in the hand' if frame.holding else 'not held'}"
        return Report(state, {**frame.counts, "laid": float(self._laid), "drops": float(self._drops)})


def _truth(frame: TwinFrame) -> Output:
    """For the camera that perception looks through."""
    return Publish(TWIN_TRUTH, TwinTruth(frame.position, frame.rotation, frame.q_rad), t_ns=frame.t_ns)

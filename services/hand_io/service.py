"""The real hand's side of the control loop: arming, the way to an episode's start, fusing, and publishing.

It never waits for the planner, and moves only while armed. What the hand shows and does goes through the same
loop as in simulation, so that planner and learner cannot tell the two apart.
"""

from __future__ import annotations

import numpy as np

from common.bus import Inbox, Input
from common.demonstrations import Demonstrations
from common.dexhand021.angles import to_normalised
from common.executor import Executed
from common.hand_messages import ArmWish, Drive, HandCommand, HandFrame, HandJoints, ObjectPose
from common.messages import Episode, Fallback, Float32, Header
from common.plant_loop import ACTIVE, Phase, PlantLoop, Seen
from common.service import Output, Publish, Report, ToPort
from common.task import DieTask
from common.topics import (
    ACK,
    ARM_REPLY,
    ARM_REQUEST,
    CHUNK,
    EPISODE,
    HAND_COMMAND,
    HAND_FRAME,
    HAND_JOINTS,
    OBJECT_POSE,
)
from services.hand_io.arming import Arming, Condition, State
from services.hand_io.config import HandIoProcess
from services.hand_io.fusion import Freshness, Fusion
from services.hand_io.watch import Watch, notes

NS_PER_S = 1e9
DIE_POSITION = slice(17, 20)  # of the state, see common/task/die.py
REST_M = 0.002  # a die that moves by more is still being laid in
JOINTS_PERIOD_NS = 100_000_000  # of hand/joints
RELAXED_FRAMES = 5  # without torque although armed: not just a command that is still on its way
REFRESHES = 4  # how often within `hold_s` the driver hears during a reset that the hold is still wanted
_EMPTY: Float32 = np.zeros(0, np.float32)
OFF = HandCommand(Drive.OFF, _EMPTY, 0)
STAY = HandCommand(Drive.HOLD, _EMPTY, 0)


class DrivenHand:
    """What the loop moves: commands for the driver, and the way to the start of an episode."""

    def __init__(self, config: HandIoProcess, task: DieTask) -> None:
        self._period_ns = config.control.period_ns
        self._reset_ns = round(config.hand_io.reset_s * NS_PER_S)
        self._settle_ns = round(config.hand_io.settle_s * NS_PER_S)
        self._refresh_ns = round(config.hand_io.hold_s * NS_PER_S) // REFRESHES
        self._start = np.clip(to_normalised(config.hand_io.start_rad), -1.0, 1.0)
        self._task = task
        self.goal: Float32 = np.zeros(task.goal_dim, np.float32)
        self.now_ns = 0
        self._reset_until_ns = 0
        self._rest: tuple[int, Float32] | None = None  # since when the die rests, and where
        self._told_ns = 0

    def reset(self, seed: int, goal: Float32) -> list[Output]:
        """Go to where the die is laid in; the goal is drawn from `seed` unless one is given."""
        self.goal = goal if goal.size else self._drawn(seed)
        self._reset_until_ns = self.now_ns + self._reset_ns
        self._rest = None
        return [self._to_start()]

    def _drawn(self, seed: int) -> Float32:
        return self._task.draw_goal(np.random.default_rng(seed)).astype(np.float32)

    def _to_start(self) -> Output:
        self._told_ns = self.now_ns
        left_ns = max(0, self._reset_until_ns - self.now_ns)
        return _order(HandCommand(Drive.FOLLOW, self._start, left_ns))

    def pursue(self, goal: Float32) -> list[Output]:
        """Show another goal."""
        self.goal = goal
        return []

    def act(self, executed: Executed) -> list[Output]:
        """Be at the action (12,) when the next step is due; zero torque when the planner stays silent."""
        if executed.fallback is Fallback.RELAX:
            return [_order(OFF)]
        return [_order(HandCommand(Drive.FOLLOW, executed.action, self._period_ns))]

    def reset_done(self, seen: Seen) -> tuple[bool, list[Output]]:
        """Whether the hand stands ready with the die at rest in it, and what it takes to wait for that."""
        position = seen.state[DIE_POSITION]
        if not seen.part_valid.all() or seen.dropped or self.now_ns < self._reset_until_ns:
            self._rest = None
        elif self._rest is None or np.abs(position - self._rest[1]).max() > REST_M:
            self._rest = self.now_ns, position
        ready = self._rest is not None and self.now_ns - self._rest[0] >= self._settle_ns
        remind = not ready and self.now_ns - self._told_ns >= self._refresh_ns
        return ready, [self._to_start()] if remind else []


def _order(command: HandCommand) -> Output:
    return ToPort("hand", HAND_COMMAND, command)


class HandIoService:
    """Steps at the control rate, and with every frame of the driver so that trouble is seen at once."""

    name = "hand_io"
    inputs = (
        Input(EPISODE, newest=True, wake=True),
        Input(CHUNK, wake=True),
        Input(ACK),
        Input(OBJECT_POSE),  # all of them: the newest may be one to refuse
        Input(HAND_FRAME, newest=True, wake=True),
        Input(ARM_REQUEST, wake=True),
    )

    def __init__(
        self,
        config: HandIoProcess,
        task: DieTask,
        boot_id: int,
        demonstrations: Demonstrations | None = None,
    ) -> None:
        own = config.hand_io
        self._task = task
        self.period_ns: int | None = config.control.period_ns
        self._hand = DrivenHand(config, task)
        self._loop = PlantLoop(config.control, task, boot_id, self._hand, demonstrations)
        fresh = Freshness(own.stale_ms, own.pose_stale_ms, own.pose_quality, config.pose_source)
        self._fusion = Fusion(task, fresh)
        self._arming = Arming(own.auto_arm, round(own.recover_s * NS_PER_S))
        self._watch = Watch(own.silent_s * 1e3)
        self._condition = Condition()
        self._assigned: Episode | None = None  # by the curriculum
        self._taken: Episode | None = None  # of those, by the loop
        self._seen: Seen | None = None
        self._off_frames = 0  # in a row, while armed
        self._frame: HandFrame | None = None
        self._pose: tuple[Header, ObjectPose] | None = None
        self._joints_ns = 0
        self._late_wishes = 0

    @property
    def boot_id(self) -> int:
        """Id of this start of the plant; another one after an episode that trouble has ended."""
        return self._loop.boot_id

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Take what came, decide whether the hand may move, and move on if it is time to."""
        self._hand.now_ns = now_ns
        self._take(now_ns, inbox)
        before = self._arming.state
        self._watch_over(now_ns)
        out, limp = self._answer(now_ns, inbox)
        out += self._follow_state(before) + limp
        if self._arming.operational:
            out += self._run(now_ns, inbox)
        return out + self._show(now_ns)

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving; the driver takes the torque off."""
        return []

    def report(self) -> Report:
        """State of arming and episode, counts of loop, driver and limits since the start of the process."""
        frame = self._frame
        fields = self._loop.fields() | (frame.counts if frame else {})
        if frame:
            fields |= {
                "board_age_ms_max": float(frame.age_ms.max()),
                "rate_hz_min": float(frame.rate_hz.min()),
            }
        fields |= {f"refused_poses_{reason}": float(n) for reason, n in self._fusion.refused.items()}
        armed = {"armed": float(self._arming.operational), "faults": float(self._arming.faults_seen)}
        armed["late_wishes"] = float(self._late_wishes)
        return Report(self._words(), fields | armed)

    def _words(self) -> str:
        state, wrong = self._arming.state, self._condition.wrong
        if wrong:
            return f"{state.value}: {'; '.join(wrong)}"
        if not self._arming.operational:
            return f"{state.value}: {'not armed' if state is State.HOLD else 'passing'}"
        lacking = self._lacking() if self._loop.phase is Phase.RESETTING else ""
        return f"{state.value}: {lacking or self._loop.phase.value}"

    def _lacking(self) -> str:
        """What an episode cannot begin without."""
        if self._seen is None or self._seen.part_valid.all():
            return "waiting for the die in the hand" if self._seen and self._seen.dropped else ""
        groups = zip(self._task.groups, self._seen.part_valid, strict=True)
        return "waiting for " + ", ".join(group.name for group, valid in groups if not valid)

    # --- what comes in ----------------------------------------------------------------------------

    def _take(self, now_ns: int, inbox: Inbox) -> None:
        for sample in inbox.take(HAND_FRAME):
            self._frame = sample.message
            off = sample.message.drive is Drive.OFF and self._arming.operational
            self._off_frames = self._off_frames + 1 if off else 0
        for sample in inbox.take(OBJECT_POSE):
            if self._fusion.accepts(now_ns, sample.header, sample.message):
                self._pose = sample.header, sample.message
        for sample in inbox.take(ACK):
            self._loop.take_ack(sample.message)
        for sample in inbox.take(EPISODE):
            self._assigned = sample.message

    def _watch_over(self, now_ns: int) -> None:
        self._condition = self._watch.judge(now_ns, self._frame)
        relaxed = self._off_frames >= RELAXED_FRAMES
        self._arming.update(now_ns, self._condition, self._loop.phase in ACTIVE, relaxed)

    def _answer(self, now_ns: int, inbox: Inbox) -> tuple[list[Output], list[Output]]:
        """Replies, and the order that has the last word: who stops a hand that is not armed wants it limp."""
        out: list[Output] = []
        limp: list[Output] = []
        for sample in inbox.take(ARM_REQUEST):
            wish: ArmWish = sample.message.wish
            if wish is ArmWish.ARM and now_ns > sample.message.deadline_ns:
                self._late_wishes += 1  # who asked was told that it failed, and may have a hand in there
                continue
            if wish is ArmWish.DISARM and not self._arming.operational:
                limp = [_order(OFF)]
            out.append(ToPort("arm", ARM_REPLY, self._arming.wish(wish)))
        return out, limp

    def _follow_state(self, before: State) -> list[Output]:
        """Take torque and episode away, or give them back.

        A hand with trouble gets no torque: a board that is silent or has restarted may be without power, and
        whoever switched it off, to free a finger, must find it limp when it is on again.
        """
        now = self._arming.state
        entered, idle = now is not before, now in (State.FAULT, State.HOLD)
        powered = self._frame is not None and self._frame.drive is not Drive.OFF
        if entered and idle and self._loop.abandon():
            self._taken = None
        if now is State.FAULT or (now is State.HOLD and self._condition.wrong):
            return [_order(OFF)] if entered or powered else []
        disarmed = now is State.HOLD and before is not State.FAULT and powered
        armed = now is State.ARMED and before is State.HOLD
        return [_order(STAY)] if entered and (disarmed or armed) else []

    # --- the control loop -------------------------------------------------------------------------

    def _run(self, now_ns: int, inbox: Inbox) -> list[Output]:
        assert self._frame is not None
        out: list[Output] = []
        if self._assigned is not None and self._assigned is not self._taken:
            self._taken = self._assigned
            out += self._loop.take_episode(self._assigned)
        self._seen = self._fusion.see(now_ns, self._frame, self._pose, self._hand.goal)
        self._loop.see(self._seen)
        if self._loop.phase is Phase.RESETTING:
            ready, orders = self._hand.reset_done(self._seen)
            out += orders
            if ready:
                self._loop.has_reset()
        for sample in inbox.take(CHUNK):
            self._loop.take_chunk(sample, now_ns)
        return out + self._loop.advance(inbox.ticks, warmup_due=bool(inbox.ticks))

    # --- for people -------------------------------------------------------------------------------

    def _show(self, now_ns: int) -> list[Output]:
        frame = self._frame
        if frame is None or now_ns - self._joints_ns < JOINTS_PERIOD_NS:
            return []
        self._joints_ns = now_ns
        joints = HandJoints(
            state=self._arming.state.value,
            faults=(*self._condition.wrong, *notes(frame)),
            q_rad=frame.angle_rad,
            target_rad=frame.target_rad,
            current_ma=frame.current_ma,
            flags=frame.flags,
            force_n=frame.force_n,
            force_valid=frame.force_valid,
            temperature_c=frame.temperature_c,
            temperature_valid=frame.temperature_valid,
            board_age_ms=frame.age_ms,
            board_rate_hz=frame.rate_hz,
        )
        return [Publish(HAND_JOINTS, joints, t_ns=frame.t_ns)]

"""Perception as a service: pictures in, the die's pose out, and never an old one as new.

Following (`track`) and searching (`register`) are jobs of two lanes, looking after the camera is one of a
third: the main loop only decides what is believed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from common.bus import Inbox, Input, JobResult
from common.camera_messages import CameraFrame, PoseResetReply, PoseState
from common.service import Job, Output, Publish, Report, ToPort
from common.topics import (
    CAMERA_FRAME,
    CAMERA_PREVIEW,
    OBJECT_POSE,
    POSE_TRACKING,
    RESET_REPLY,
    RESET_REQUEST,
)
from services.perception import rigid
from services.perception.backend import PoseEstimate, Unseen
from services.perception.config import PerceptionConfig
from services.perception.counts import Counts, report
from services.perception.filter import Measured, PoseFilter, Verdict
from services.perception.frames import Float64, Frame, frame_of
from services.perception.last_place import LastPlace
from services.perception.palm_tag import Mount
from services.perception.reach import Reach
from services.perception.screen import Screen
from services.perception.status import Said, Status
from services.perception.told import object_pose, tracking
from services.perception.worker import Look, PoseWorker

NS_PER_S, NS_PER_MS = 1e9, 1e6
PERIOD_NS = 50_000_000
REPEAT_NS = 500_000_000  # how often the state is told when nothing happens


class PerceptionService:
    """Follows one die; steps with each picture, with each answer of its workers, and at ticks."""

    name = "perception"
    inputs = (Input(CAMERA_FRAME, newest=True, wake=True), Input(RESET_REQUEST, wake=True))
    period_ns: int | None = PERIOD_NS

    def __init__(
        self,
        config: PerceptionConfig,
        worker: PoseWorker,
        T_palm_camera: Float64,
        misfit: Callable[[Float64], str],
        boot_id: int,
        *,
        camera: Callable[[], Report] = lambda: Report(""),
    ) -> None:
        self.boot_id = boot_id
        self._config, self._worker, self._camera = config, worker, camera
        self._T_palm_camera = T_palm_camera
        self._screen = Screen(config.screen, misfit)
        self._status = Status(config.silence)
        self._filter = PoseFilter(config.filter)
        self._place = LastPlace(config.elsewhere)
        self._reach = Reach(config.reach, T_palm_camera)
        self._counts = Counts()
        self._search = 0  # number of the present one; answers and failures of earlier ones are not taken
        self._tracking: Frame | None = None  # by the backend at the moment
        self._waiting: Frame | None = None  # the newest fit picture that came meanwhile
        self._registering = False
        self._search_ns = 0  # when the next search may begin
        self._looking = False
        self._looked_ns = self._drawn_ns = 0
        self._look = Look(Mount.UNKNOWN, 0.0, "", None)
        self._told: Said | None = None
        self._told_ns = 0

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Take answers, wishes and pictures; then tell what has changed."""
        out: list[Output] = []
        for result in inbox.results:
            out += self._take_result(now_ns, result)
        for _ in inbox.take(RESET_REQUEST):
            out += self._reset("searching anew")
        for sample in inbox.take(CAMERA_FRAME):
            self._take_frame(now_ns, sample.message)
        if self._status.silent(now_ns) and not self._searches():
            self._status.lose()  # it may be anywhere when the camera is back
            out += self._forget()
        out += self._follow()
        return out + self._tell(now_ns)

    def stop(self, now_ns: int) -> list[Output]:
        """Nothing needs saving."""
        return []

    def report(self) -> Report:
        """State, counts since the start, and times over the last pictures."""
        said = self._told or Said(PoseState.SEARCHING, "")
        own = {"palm_tag_px": self._look.offset_px, "knocked": float(self._look.mount is Mount.KNOCKED)}
        refused = {f"refused_{fault.value}": float(n) for fault, n in self._screen.counts.items()}
        return report(said, self._counts.fields() | refused | own, self._camera())

    # --- what comes in ----------------------------------------------------------------------------

    def _take_frame(self, now_ns: int, message: CameraFrame) -> None:
        self._counts.arrived(message.frame_number)
        try:
            frame = frame_of(message)
        except ValueError as error:
            self._counts.add("refused_invalid")
            self._status.refused(now_ns, f"picture refused: {error}")
            return
        wrong = self._screen.judge(now_ns, frame)
        if wrong:
            self._status.refused(now_ns, wrong)
            return
        self._status.fit(now_ns)
        self._waiting = frame

    def _take_result(self, now_ns: int, result: JobResult) -> list[Output]:
        if result.name == "look":
            return self._take_look(now_ns, result)
        what, search = result.name.split()
        frame = None
        if what == "track":
            frame, self._tracking = self._tracking, None
        elif what == "register":
            self._registering = False
            self._search_ns = now_ns + round(self._config.search_pause_s * NS_PER_S)
        present = int(search) == self._search
        if result.error:
            return self._take_failure(what, present, result.error)
        if not present or not isinstance(result.value, (PoseEstimate, Unseen)):
            return []
        if what == "register":
            return self._take_registered(result.value)
        assert frame is not None
        return self._take_tracked(now_ns, frame, result.value, result.duration_ns / NS_PER_MS)

    def _take_failure(self, what: str, present: bool, error: str) -> list[Output]:
        """Begin anew, unless nobody waits for what has failed."""
        self._counts.add("failed_jobs")
        if not present or (what == "register" and not self._searches()):
            return []
        self._status.trouble(f"{what} failed: {error}")
        return self._forget()

    def _take_registered(self, result: PoseEstimate | Unseen) -> list[Output]:
        self._counts.add("searches")
        if isinstance(result, Unseen):
            self._status.searched(result)
            return []
        self._counts.add("found")
        return [self._job("adopt", self._worker.adopt, result)]

    def _take_tracked(
        self, now_ns: int, frame: Frame, result: PoseEstimate | Unseen, solve_ms: float
    ) -> list[Output]:
        latency_ms = max(0.0, (now_ns - frame.t_ns) / NS_PER_MS)
        self._counts.solved(solve_ms, latency_ms)
        out: list[Output] = []
        claimed = False
        if isinstance(result, PoseEstimate):
            pose, claimed = self._judged(result)
            out.append(pose)
        else:
            self._status.unseen(result)
            self._filter.reset()
            out += self._search_in(now_ns, frame)
        self._told, self._told_ns = self._status.now(now_ns), now_ns
        message = tracking(self._told, result, claimed=claimed, latency_ms=latency_ms, solve_ms=solve_ms)
        out.append(Publish(POSE_TRACKING, message, t_ns=frame.t_ns))
        return out + self._look_at(now_ns, frame, result)

    def _judged(self, estimate: PoseEstimate) -> tuple[Output, bool]:
        """The pose to publish, and whether it is claimed."""
        measured = self._measured(estimate)
        doubt = self._look.warning or self._reach.doubt(measured.position)
        if estimate.claimed and not doubt:
            doubt = self._filtered(measured)
        self._status.found(estimate, doubt)
        claimed = estimate.claimed and not doubt
        if claimed:
            self._place.claimed(measured)
        self._counts.add("claimed" if claimed else "unclaimed")
        filtered = self._filter.pose()
        pose = filtered if claimed and filtered is not None else measured
        message = object_pose(pose, estimate)
        return Publish(OBJECT_POSE, message, t_ns=estimate.t_ns, valid=claimed), claimed

    def _measured(self, estimate: PoseEstimate) -> Measured:
        """The pose in the palm's frame."""
        position, rotation = rigid.split(self._T_palm_camera @ estimate.T_camera_die)
        covariance = rigid.turn_covariance(self._T_palm_camera[:3, :3], estimate.covariance)
        return Measured(estimate.t_ns, position, rotation, covariance)

    def _filtered(self, measured: Measured) -> str:
        """Pass a claimed pose through the filter; why it is not believed, if it is not."""
        doubt = self._place.doubt(measured)
        if doubt:
            self._counts.add("outliers")
            return doubt
        before = self._filter.pose()
        verdict = self._filter.update(measured)
        if verdict is Verdict.OUTLIER and before is not None:
            self._counts.add("outliers")
            jump_mm = 1e3 * float(np.linalg.norm(measured.position - before.position))
            return f"the pose jumped by {jump_mm:.0f} mm or turned at once: a second die, or a slipped face?"
        if verdict is Verdict.BACKWARDS:
            return "the pose is not newer than the one before"
        self._counts.add("jumps", verdict is Verdict.STARTED and before is not None)
        return ""

    # --- what goes out ----------------------------------------------------------------------------

    def _follow(self) -> list[Output]:
        """Give the newest picture to the backend."""
        frame = self._waiting
        if frame is None or self._tracking is not None:
            return []
        self._tracking, self._waiting = frame, None
        return [self._job("track", self._worker.track, frame, self._config.declared_track_ms)]

    def _search_in(self, now_ns: int, frame: Frame) -> list[Output]:
        """Begin a search in a picture in which the backend has not seen the die."""
        if self._registering or now_ns < self._search_ns:
            return []
        self._registering = True
        declared_ms = self._config.declared_register_ms
        return [self._job("register", self._worker.register, frame, declared_ms, "register")]

    def _job(
        self,
        what: str,
        function: Callable[..., object],
        on: Frame | PoseEstimate,
        declared_ms: float = 0.0,
        lane: str = "track",
    ) -> Job:
        """A job of the present search, whose number its name carries."""
        return Job(f"{what} {self._search}", function, (on,), round(declared_ms * NS_PER_MS), lane)

    def _searches(self) -> bool:
        return self._status.state in (PoseState.SEARCHING, PoseState.LOST)

    def _forget(self) -> list[Output]:
        """Begin a new search; answers that are still to come belong to the old one."""
        self._search += 1
        self._search_ns = 0
        self._filter.reset()
        return [Job(f"reset {self._search}", self._worker.reset, lane="track")]

    def _reset(self, reason: str) -> list[Output]:
        self._counts.add("resets")
        self._place.forget()
        self._status.reset()
        reply = PoseResetReply(accepted=True, state=self._status.state.value, reason=reason)
        return [*self._forget(), ToPort("reset", RESET_REPLY, reply)]

    def _look_at(self, now_ns: int, frame: Frame, result: PoseEstimate | Unseen) -> list[Output]:
        """Look after the camera, and draw for people, each at its own rate."""
        config = self._config
        draw = config.preview_hz > 0 and now_ns - self._drawn_ns >= NS_PER_S / config.preview_hz
        due = now_ns - self._looked_ns >= config.knock.period_s * NS_PER_S
        if self._looking or not (draw or due):
            return []
        self._looking, self._looked_ns = True, now_ns
        self._drawn_ns = now_ns if draw else self._drawn_ns
        estimate = result if isinstance(result, PoseEstimate) else None
        said = self._told or self._status.now(now_ns)
        return [Job("look", self._worker.look, (frame, estimate, said, draw), lane="look")]

    def _take_look(self, now_ns: int, result: JobResult) -> list[Output]:
        self._looking = False
        if not isinstance(result.value, Look):
            self._counts.add("failed_jobs")
            return []
        self._look = result.value
        self._status.warn(self._look.warning)
        if self._look.preview is None:
            return []
        return [Publish(CAMERA_PREVIEW, self._look.preview, t_ns=now_ns)]

    def _tell(self, now_ns: int) -> list[Output]:
        """Tell of a change that no picture brought, and now and then that there is none."""
        said = self._status.now(now_ns)
        changed = self._told is None or said.state is not self._told.state
        if not changed and now_ns - self._told_ns < REPEAT_NS:
            return []
        self._told, self._told_ns = said, now_ns
        return [Publish(POSE_TRACKING, tracking(said))]

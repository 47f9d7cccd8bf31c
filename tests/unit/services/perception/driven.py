"""The perception service stepped by hand, its workers' jobs done when told, over a real inbox and codec."""

from __future__ import annotations

from collections import Counter

import numpy as np

from common import geometry
from common.bus import Inbox, JobResult
from common.camera_messages import PoseReset
from common.codec import Codec
from common.die import DIE
from common.messages import Header
from common.runner import run_job
from common.service import Job, Publish, ToPort
from common.topics import CAMERA_FRAME, OBJECT_POSE, POSE_TRACKING, RESET_REQUEST
from services.perception import rigid
from services.perception.camera_port import message_of
from services.perception.config import CubeConfig, PerceptionConfig
from services.perception.cube import CubeBackend
from services.perception.reach import Reach
from services.perception.service import PerceptionService
from services.perception.worker import PoseWorker
from tests.unit.services.perception.cubes import frame
from tests.unit.services.perception.flat import CAMERA_MATRIX

FRAME_NS = 33_333_333
LATENCY_NS = 30_000_000  # from capture to arrival
T_PALM_CAMERA = rigid.join((0.46, 0.0, 0.15), geometry.normalise(np.array([0.5, -0.5, -0.5, 0.5])))
HELD = rigid.join((0.01, -0.005, 0.40), geometry.normalise(np.array([0.35, 0.8, 0.3, 0.35])))
STEADY = {"preview_hz": 0.0, "knock": {"period_s": 1e6}}


def no_misfit(camera_matrix):
    return "" if np.allclose(camera_matrix, CAMERA_MATRIX) else "another K than calibrated"


class DrivenPerception:
    """`see` shows a picture and does all jobs at once; what was published is in `poses` and `tracking`."""

    def __init__(self, backend=None, tag=None, misfit=no_misfit, camera=None, **options):
        config = PerceptionConfig(**{**STEADY, **options})
        self.backend = backend or CubeBackend(CubeConfig(), DIE)
        worker = PoseWorker(self.backend, Reach(config.reach, T_PALM_CAMERA).mask, DIE, tag)
        told = {"camera": camera} if camera else {}
        self.service = PerceptionService(config, worker, T_PALM_CAMERA, misfit, 11, **told)
        self.codec, self.now_ns = Codec(), 10**18
        self.inbox = Inbox(self.codec, self.service.inputs)
        self._seq, self.number = Counter(), 0
        self.poses, self.tracking, self.previews, self.replies, self.jobs = [], [], [], [], []

    def send(self, topic, message):
        self._seq[topic.key] += 1
        header = Header(22, self._seq[topic.key], self.now_ns, True)
        self.inbox.sink(topic)(topic.key, self.codec.encode(header, message))

    def see(self, pose=HELD, **changes):
        """A picture of the cube at a pose (None: of no cube), arriving LATENCY_NS after it was taken."""
        self.number += 1
        t_ns = changes.pop("t_ns", self.now_ns + FRAME_NS - LATENCY_NS)
        picture = frame(pose, self.number, t_ns, **changes)
        return self.show(picture)

    def show(self, picture):
        self.now_ns += FRAME_NS
        self.send(CAMERA_FRAME, message_of(picture))
        self.turn()
        self.work()
        return self.said

    def wait(self, seconds):
        """Let time pass with ticks and without pictures."""
        for _ in range(round(seconds * 20)):
            self.now_ns += 50_000_000
            self.turn(ticks=1)
            self.work()
        return self.said

    def turn(self, ticks=0):
        self.inbox.collect(self.now_ns, ticks)
        for output in self.service.step(self.now_ns, self.inbox):
            if isinstance(output, Job):
                self.jobs.append(output)
            elif isinstance(output, ToPort):
                self.replies.append(output.message)
            elif isinstance(output, Publish):
                self._keep(output)

    def _keep(self, output):
        t_ns = self.now_ns if output.t_ns is None else output.t_ns
        header = Header(11, 1, t_ns, output.valid)
        sample = self.codec.decode(output.topic.key, self.codec.encode(header, output.message))
        kept = {OBJECT_POSE: self.poses, POSE_TRACKING: self.tracking}.get(output.topic, self.previews)
        kept.append(sample)

    def work(self):
        """Do what waits, and what that leads to."""
        while self.jobs:
            self.do(self.jobs.pop(0))

    def do(self, job):
        value, error = run_job(job)
        self.inbox.finish(JobResult(job.name, value, error, 5_000_000))
        self.turn()

    def reset(self):
        self.send(RESET_REQUEST, PoseReset(True))
        self.turn()
        self.work()
        return self.replies[-1]

    def tracked(self):
        """Bring it to where it follows the cube."""
        for _ in range(4):
            self.see()
        assert self.said.state == "tracking", self.said
        self.poses.clear()
        return self

    @property
    def said(self):
        return self.tracking[-1].message

    @property
    def fields(self):
        return self.service.report().fields

    @property
    def words(self):
        return self.service.report().state

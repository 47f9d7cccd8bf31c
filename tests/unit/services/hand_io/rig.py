"""hand_io and an emulated hand, both live, on a CAN bus within this process."""

from __future__ import annotations

import itertools
import threading
import time

import numpy as np

from common.built import Built, codec_for
from common.bus import LocalBus
from common.can_config import CanConfig
from common.cell import ControlConfig
from common.clock import WallClock
from common.codec import Codec
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import Hand
from common.hand_messages import ArmRequest, ArmWish
from common.live import LiveRunner
from common.messages import Episode, Header, Mode, Warmup
from common.runner import Dispatcher
from common.task import get_die_task
from common.task.die import TASK_OF
from common.topics import ARM_REPLY, ARM_REQUEST, EPISODE, HAND_JOINTS, HEALTH, STEP
from services.hand_io.build import build
from services.hand_io.config import HandIoConfig, HandIoProcess
from services.sim.emulator_config import EmulatorConfig, EmulatorProcess, Fault
from services.sim.emulator_port import EmulatorPort
from services.sim.emulator_service import EmulatorService
from tests.unit.services.hand_io.kinematic import KinematicTwin

QUICK = {
    "hold_s": 0.6,
    "stale_ms": 250.0,
    "pose_stale_ms": 500.0,
    "silent_s": 0.7,
    "recover_s": 0.2,
    "reset_s": 0.2,
    "settle_s": 0.05,
    "clear_s": 0.1,
    "max_clear_s": 0.4,
    "reopen_s": 0.1,
    "max_reopen_s": 0.2,
    "limits": {"backoff_s": 0.2, "max_backoff_s": 0.4},
}
_numbers = itertools.count()
DIE = codec_for("die")


class Rig:
    """From start to `close`; what was published is in `steps`, `joints` and `health`."""

    def __init__(
        self, interface="virtual", port=43113, twin=None, hand=Hand.RIGHT, startup="restart", **options
    ):
        channel = "239.74.163.2" if interface == "udp_multicast" else f"rig{next(_numbers)}"
        self.can = CanConfig(interface=interface, channel=channel, port=port)
        task, assumed = get_die_task(TASK_OF[hand], hand), DexHandConfig(hand=hand, startup_frame=startup)
        shared = {"task": task.name, "can": self.can, "hand": assumed}
        shared |= {"control": ControlConfig(rate_hz=20, steps_per_plan=1)}
        config = HandIoProcess(**shared, hand_io=HandIoConfig(**{**QUICK, **options}))
        own = EmulatorConfig(silence_s=0.2, lay_after_s=0.05)
        self.twin = twin or KinematicTwin()
        self.emulator = EmulatorPort(self.can, assumed, own, self.twin, task)
        self.bus = LocalBus()
        self.steps, self.joints, self.health = [], [], []
        for topic, kept in ((STEP, self.steps), (HAND_JOINTS, self.joints), (HEALTH, self.health)):
            self.bus.subscribe(topic, lambda key, payload, kept=kept: kept.append(DIE.decode(key, payload)))
        self.built = build(config, 11)
        emulator = Built(
            EmulatorService(EmulatorProcess(**shared, emulator=own), 12), {"twin": self.emulator}
        )
        self._stop = threading.Event()
        self._threads = [self._start(emulator), self._start(self.built)]
        self._episodes = itertools.count(1)

    def _start(self, built):
        dispatcher = Dispatcher(built.service, DIE, self.bus, built.ports)
        runner = LiveRunner(dispatcher, WallClock(), "hash")
        thread = threading.Thread(target=runner.run, args=(self._stop,), daemon=True)
        thread.start()
        return thread

    def close(self):
        self._stop.set()
        for thread in self._threads:
            thread.join(5)

    def ask(self, wish):
        codec = Codec()
        request = codec.encode(Header(1, 0, 0, True), ArmRequest(wish))
        reply = codec.decode(ARM_REPLY.key, self.built.queries["hand/arm"](request)).message
        assert ARM_REQUEST.key == "port/arm"
        return reply

    def arm(self, wish=ArmWish.ARM):
        return self.ask(wish)

    def begin(self, mode=Mode.RANDOM, steps=100_000, number=None):
        number = next(self._episodes) if number is None else number
        goal = np.zeros(0, np.float32)
        message = Episode(number, 0, goal, mode, Warmup.UNIFORM, steps, 5)
        self.bus.publish(EPISODE, EPISODE.key, DIE.encode(Header(44, number, 0, True), message))
        return number

    def run(self):
        """Bring it to the point where random actions are being executed."""
        self.wait(lambda: self.state != "fault", "the fault to pass")
        if not self.armed:
            self.wait(lambda: self.arm().accepted, "arming")
        self.begin()
        self.next_steps(3)

    def next_steps(self, count=2):
        seen = len(self.steps)
        self.wait(lambda: len(self.steps) >= seen + count, f"{count} steps")
        return [sample.message for sample in self.steps[seen:]]

    def inject(self, kind, **values):
        self.emulator.inject(Fault(kind=kind, **values))

    def wait(self, reached, what, seconds=5.0):
        deadline = time.monotonic() + seconds
        while not reached():
            assert time.monotonic() < deadline, (
                f"waited in vain for {what}; {self.joint and self.joint.faults}"
            )
            time.sleep(0.005)

    @property
    def joint(self):
        return self.joints[-1].message if self.joints else None

    @property
    def state(self):
        return self.joint.state if self.joint else ""

    @property
    def armed(self):
        return self.state in ("armed", "running", "relax")

    def told(self, words):
        return self.joint is not None and any(words in fault for fault in self.joint.faults)

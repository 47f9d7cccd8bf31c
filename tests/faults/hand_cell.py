"""hand_io and an emulated hand as processes on a CAN bus of their own, and all that a test does with them."""

import contextlib
import itertools
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from bench.can import free_port
from common.built import codec_for
from common.codec import Codec
from common.hand_messages import ArmReply, ArmRequest, ArmWish
from common.messages import Episode, Header, Mode, Warmup
from common.topics import ARM_REPLY, EPISODE, HAND_JOINTS, HEALTH, STEP
from common.zenoh_router import Router
from deploy.cell import load_cell, on_this_machine, write_process_configs
from deploy.supervisor import REPOSITORY
from services.hand_io.desk import QUERY
from services.sim.dexhand_twin import DexHandTwin
from services.sim.emulator_config import Fault
from services.sim.emulator_port import FAULT_QUERY
from tests.faults.cell import Ear, free_ports, wait
from tests.faults.traced_emulator import TRACE

QUICK = (
    "control.rate_hz=20",
    "hand_io={auto_arm: false, hold_s: 0.6, stale_ms: 250, pose_stale_ms: 500, silent_s: 1.2, recover_s: 0.2,"
    " reset_s: 0.2, settle_s: 0.05, clear_s: 0.1, max_clear_s: 0.4, reopen_s: 0.1, max_reopen_s: 0.2,"
    " limits: {backoff_s: 0.2, max_backoff_s: 0.4}}",
    "emulator.silence_s=0.2",
    "emulator.lay_after_s=0.05",
)
LIVELY_SEED = 0  # whose random postures are held long enough to reach the ends of the ranges
MODULES = {"emulator": "tests.faults.traced_emulator", "hand_io": "services.hand_io"}
DIE = codec_for("die")


class Physics:
    """What the emulator's twin went through, read from its own trace."""

    def __init__(self, path):
        self._path = path
        model = DexHandTwin().model
        self.columns = 1 + model.nq + 12
        joints = [model.joint(i) for i in range(model.njnt) if model.jnt_limited[i]]
        self._addresses = [1 + int(joint.qposadr[0]) for joint in joints]
        self._motors = [1 + int(model.joint(model.actuator(i).trnid[0]).qposadr[0]) for i in range(12)]
        self.low, self.high = np.array([joint.range for joint in joints]).T

    def rows(self):
        data = np.fromfile(self._path)
        return data[: len(data) // self.columns * self.columns].reshape(-1, self.columns)

    def since(self, at):
        rows = self.rows()
        return rows[rows[:, 0] > at]

    def angles(self, rows):
        """Of the motors' joints: (n, 12) rad."""
        return rows[:, self._motors]

    @property
    def powered(self):
        """Which motors have torque now: (12,)."""
        return self.rows()[-1, -12:] > 0

    def beyond_rad(self, rows):
        """How far any joint of the hand, motor or passive, was ever beyond its range."""
        q = rows[:, self._addresses]
        return float(np.maximum(self.low - q, q - self.high).max())

    def moved_rad(self, rows):
        return float(np.ptp(self.angles(rows), axis=0).max())


class HandCell:
    """From start to `end`."""

    def __init__(self, run_dir, *sets):
        port, self.can_port = free_ports(1)[0], free_port()
        endpoint = f"tcp/127.0.0.1:{port}"
        own = (f"run_dir={run_dir}", f"bus.listen=[{endpoint}]", f"bus.connect=[{endpoint}]")
        sets = (
            *QUICK,
            *own,
            f"can.port={self.can_port}",
            "log.enabled=false",
            "bus.connect_timeout_s=90",
            *sets,
        )
        self._router = Router((endpoint,))
        self.cell = on_this_machine(load_cell("dexhand_twin", sets))
        self._files = write_process_configs(self.cell)
        self.physics = Physics(Path(run_dir, TRACE))
        self.processes = {name: self.start(name) for name in MODULES}
        self.ear = Ear(port, self.cell.cell, "die", (STEP, HEALTH, HAND_JOINTS))
        self._episodes = itertools.count(1)

    def start(self, name):
        words = [sys.executable, "-m", MODULES[name], "--config", str(self._files.config_of(name))]
        return subprocess.Popen(words, cwd=REPOSITORY)

    def ready(self):
        """Wait until all boards are heard."""
        wait(lambda: self.joints is not None and not self.joints.faults, self.describe)

    def describe(self):
        ended = {name: process.poll() for name, process in self.processes.items()}
        return f"the hand: {ended}, {self.joints}, {self.ear.health('hand_io')}"

    def end(self):
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5)
            process.kill()
            process.wait()
        self.ear.close()
        self._router.close()

    # --- what a person does -----------------------------------------------------------------------

    def ask(self, wish=ArmWish.ARM):
        codec = Codec()
        request = codec.encode(Header(1, 0, 0, True), ArmRequest(wish))
        answer = self.ear.bus.ask(QUERY, request, 5.0)
        return codec.decode(ARM_REPLY.key, answer).message if answer else ArmReply(False, "", "no answer")

    def begin(self, steps=100_000):
        number = next(self._episodes)
        message = Episode(number, 0, np.zeros(0, np.float32), Mode.RANDOM, Warmup.MIX, steps, LIVELY_SEED)
        payload = DIE.encode(Header(44, number, 0, True), message)
        self.ear.bus.publish(EPISODE, EPISODE.key, payload)
        return number

    def run(self):
        """Bring it to the point where random actions are being executed."""
        wait(lambda: self.state != "fault", "the fault to pass")
        if self.state not in ("armed", "running", "relax"):
            wait(lambda: self.ask().accepted, "arming")
        if self.state != "running":
            self.begin()
        self.next_steps(3)

    def inject(self, kind, **values):
        fault = Fault(kind=kind, **values).model_dump(mode="json")
        assert self.ear.bus.ask(FAULT_QUERY, json.dumps(fault).encode(), 5.0) == b""

    # --- what a person sees -----------------------------------------------------------------------

    @property
    def steps(self):
        return self.ear.samples(STEP)

    def next_steps(self, count=2):
        seen = len(self.steps)
        wait(lambda: len(self.steps) >= seen + count, f"{count} steps")
        return [sample.message for sample in self.steps[seen:]]

    @property
    def joints(self):
        sample = self.ear.newest(HAND_JOINTS)
        return sample.message if sample else None

    @property
    def state(self):
        return self.joints.state if self.joints else ""

    def told(self, words, since, state=""):
        """Whether the dashboard has shown these words (in that state) since then."""
        shown = [sample.message for sample in self.ear.samples(HAND_JOINTS, since)]
        return any(words in "; ".join(one.faults) and state in ("", one.state) for one in shown)

    def reported(self, words, since):
        """Whether the state of hand_io in `status` has said so since then."""
        return any(words in s.message.state for s in self.ear.samples(HEALTH, since))

    def counts(self):
        """All counts of hand_io, from a heartbeat that is newer than now."""
        now = time.monotonic()
        return wait(lambda: self.ear.health("hand_io", now), "a heartbeat").fields

    def count(self, field):
        return self.counts().get(field, 0.0)

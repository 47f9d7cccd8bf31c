"""The emulated hand's thread, on a bus that fails."""

import errno
import threading

import can

from common.can_config import CanConfig
from common.dexhand021.config import DexHandConfig
from common.task import get_task
from services.sim.emulator_config import EmulatorConfig, Fault
from services.sim.emulator_port import EmulatorPort
from tests.unit.services.hand_io.kinematic import KinematicTwin


class FullBus:
    """Nothing can be sent and nothing is heard."""

    state = can.BusState.ACTIVE

    def send(self, _message, timeout=None):
        error = can.CanOperationError("full", errno.ENOBUFS)
        raise error from OSError(errno.ENOBUFS, "No buffer space available")

    def recv(self, _timeout):
        return None

    def shutdown(self):
        pass


def test_the_physics_go_on_when_nobody_can_be_told_that_the_bus_is_off(monkeypatch):
    monkeypatch.setattr(can, "Bus", lambda **_arguments: FullBus())
    config = EmulatorConfig(faults=(Fault(kind="bus_off", for_s=60.0),), pose_hz=100.0)
    port = EmulatorPort(CanConfig(), DexHandConfig(), config, KinematicTwin(), get_task("die"))
    frames, enough = [], threading.Event()

    def deliver(_topic, frame):
        frames.append(frame)
        if len(frames) >= 3:
            enough.set()

    port.open(deliver)
    try:
        assert enough.wait(10.0), "the thread has ended"
    finally:
        port.close()

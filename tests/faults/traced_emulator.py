"""The emulated hand's process, run as the real one, with two differences.

Nothing in it keeps a joint within the narrower of the published ranges, which hand_io must keep to: set
points are not cut, and the end stops are where the wider range ends. And it writes down where its physics
really is: rows of float64 go to `physics.f8` in the run directory, one after each round of physics, with the
monotonic time, every coordinate of the model, and which motors (12,) have torque.
"""

import os
import time
from pathlib import Path

import numpy as np

from common.dexhand021.tables import JOINTS
from common.process import run_process
from services.sim import emulator
from services.sim.dexhand_links import MOTOR_JOINTS
from services.sim.dexhand_twin import DexHandTwin
from services.sim.emulator_config import EmulatorProcess

TRACE = "physics.f8"


def build(config, boot_id):
    trace = os.open(Path(config.run_dir, TRACE), os.O_CREAT | os.O_WRONLY | os.O_APPEND)

    class TracedTwin(DexHandTwin):
        def __init__(self, *positional, **named):
            super().__init__(*positional, **named)
            self.model.actuator_ctrllimited[:] = 0
            for name, joint in zip(MOTOR_JOINTS, JOINTS, strict=True):
                self.model.joint(name).range[1] = max(joint.model_high_rad, np.radians(joint.sdk_high_deg))

        def set_targets(self, position_rad):
            wanted = np.asarray(position_rad)
            self.data.ctrl[:] = np.where(np.isnan(wanted), self.data.ctrl, wanted)

        def advance(self, seconds):
            super().advance(seconds)
            row = np.concatenate([[time.monotonic()], self.data.qpos, self.powered])
            os.write(trace, row.tobytes())

    emulator.DexHandTwin = TracedTwin
    return emulator.build(config, boot_id)


if __name__ == "__main__":
    run_process("emulator", EmulatorProcess, build)

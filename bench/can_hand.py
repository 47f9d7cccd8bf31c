"""The emulated hand without the cell's bus, as a process for `bench.can`: lives until its input ends."""

from __future__ import annotations

import argparse
import gc
import sys
import time

from common.can_config import CanConfig
from common.dexhand021.config import DexHandConfig
from common.process import SWITCH_S
from services.sim.dexhand_twin import DexHandTwin
from services.sim.emulator_config import EmulatorConfig
from services.sim.emulator_port import EmulatorPort


def main() -> None:
    """Say `ready`, answer on the bus, end with standard input, and say how much CPU time (s) that took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, required=True, help="of the multicast group")
    sys.setswitchinterval(SWITCH_S)
    can = CanConfig(interface="udp_multicast", port=parser.parse_args().port)
    twin, hand = DexHandTwin(), DexHandConfig()
    port = EmulatorPort(can, hand, EmulatorConfig(), twin, twin.task)
    gc.freeze()  # as processes of a cell do
    port.open(lambda _topic, _message: None)
    begin_s = time.process_time()
    print("ready", flush=True)
    sys.stdin.read()
    print(time.process_time() - begin_s)
    port.close()


if __name__ == "__main__":
    main()

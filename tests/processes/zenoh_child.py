"""A process on the bus for the tests beside it: `python -m tests.processes.zenoh_child ROLE ENDPOINT ...`."""

from __future__ import annotations

import signal
import sys
import threading
import time

from common.bus_config import BusConfig
from common.topics import SNAPSHOT, STEP, Topic
from common.zenoh_bus import ZenohBus

SNAPSHOT_BYTES = 15_000_000


def publish(bus: ZenohBus, topic: Topic, boot: int, period_s: float, size: int) -> None:
    """Publish `boot i time_ns` padded to `size` until TERM; then print the count and the slowest call, ms."""
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    sent, worst_s = 0, 0.0
    while not stop.wait(period_s):
        payload = f"{boot} {sent} {time.time_ns()} ".encode().ljust(size, b".")
        started = time.perf_counter()
        bus.publish(topic, topic.key, payload)
        worst_s = max(worst_s, time.perf_counter() - started)
        sent += 1
        if sent == 1:
            print("up", flush=True)
    bus.close()
    print(sent, worst_s * 1000, flush=True)


def listen(bus: ZenohBus) -> None:
    """Subscribe and leave at TERM without closing anything: the process must end all the same."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    for topic in (STEP, SNAPSHOT):
        bus.subscribe(topic, lambda _key, _payload: None)
    bus.serve("some/question", lambda payload: payload)
    print("up", flush=True)
    while True:
        time.sleep(1)


def main() -> None:
    """Play one role."""
    role, endpoint, *rest = sys.argv[1:]
    bus = ZenohBus(BusConfig(connect=(endpoint,)), "cell", role)
    if role == "steps":
        publish(bus, STEP, int(rest[0]), float(rest[1]), 600)
    elif role == "snapshots":
        publish(bus, SNAPSHOT, 1, float(rest[0]), SNAPSHOT_BYTES)
    else:
        listen(bus)


if __name__ == "__main__":
    main()

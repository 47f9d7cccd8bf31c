"""What the bus to the hand costs: `python -m bench.can` prints one JSON object.

A command goes out 100 times a second over udp_multicast, and six boards answer it from another process, that
of the emulated hand with its physics. round_trip = from sending the command to having the sixth answer; a
cycle is lost when that takes more than 50 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.provenance import provenance
from common.can_config import CanConfig
from common.can_link import BadFrame, Busy, CanLink
from common.clock import Ticker
from common.dexhand021 import host
from common.dexhand021.commands import BroadcastMotion, MotorTarget
from common.dexhand021.config import DexHandConfig
from common.dexhand021.replies import BoardFeedback
from common.dexhand021.tables import BOARDS, JOINTS
from services.hand_io.config import HandIoConfig

ROOT = Path(__file__).parents[1]
LOST_MS = 50.0
HOLD_CDEG = 2000  # where the motors are told to be, if their range goes so far: the load of a hand that holds
LIMITS = {"round_trip_ms_p50": 2.0, "round_trip_ms_p99": 8.0, "lost_cycles": 20.0}


@dataclass
class Measured:
    """Round trips of the cycles that were answered in time, and how many were not."""

    round_trips_ms: list[float] = field(default_factory=list[float])
    lost: int = 0
    skipped: int = 0  # cycles that this process began too late to send
    unsent: int = 0
    cpu_s: float = 0.0  # of sending and reading


@dataclass
class HandProcess:
    """The emulated hand in a process of its own."""

    cpu_s: float = 0.0  # of answering, known once it has ended


@contextlib.contextmanager
def emulated_hand(port: int) -> Iterator[HandProcess]:
    """Run the emulated hand in a process of its own."""
    hand = HandProcess()
    command = [sys.executable, "-m", "bench.can_hand", "--port", str(port)]
    child = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        if child.stdout.readline().strip() != b"ready":
            raise RuntimeError(f"the emulated hand ended with code {child.wait()}")
        yield hand
    finally:
        said, _ = child.communicate()
    hand.cpu_s = float(said)


def free_port() -> int:
    """A UDP port that nobody has: channels that share one hear each other."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


def measure(link: CanLink, cycles: int, rate_hz: float) -> Measured:
    """Send `cycles` commands at `rate_hz` and wait for the answers to each."""
    hand = DexHandConfig()
    held = [min(HOLD_CDEG, joint.high_cdeg) for joint in JOINTS]
    targets = tuple(MotorTarget(True, position, hand.speed, hand.current) for position in held)
    frame = host.encode(BroadcastMotion(hand.hand, hand.control_mode, targets))
    found = Measured()
    began_s = time.process_time()
    ticker = Ticker(round(1e9 / rate_hz), time.monotonic_ns())
    for _ in range(cycles):
        time.sleep(max(0.0, (ticker.next_ns - time.monotonic_ns()) / 1e9))
        found.skipped += ticker.take(time.monotonic_ns()) - 1
        _drain(link)
        begin = time.monotonic()
        try:
            link.send(frame)
        except Busy:
            found.unsent += 1
            continue
        if _answered(link, begin + LOST_MS / 1e3):
            found.round_trips_ms.append((time.monotonic() - begin) * 1e3)
        else:
            found.lost += 1
    found.cpu_s = time.process_time() - began_s
    return found


def _drain(link: CanLink) -> None:
    with contextlib.suppress(BadFrame):
        while link.receive(0.0) is not None:
            pass


def _answered(link: CanLink, deadline: float) -> bool:
    waiting = set(range(1, 2 * len(BOARDS) + 1))
    while (left := deadline - time.monotonic()) > 0:
        with contextlib.suppress(BadFrame):
            frame = link.receive(left)
            reply = host.decode(frame) if frame else None
            if isinstance(reply, BoardFeedback):
                waiting.discard(reply.board)
                if len(waiting) == len(BOARDS):  # the boards of the other hand stay silent
                    return True
    return False


def result(found: Measured, hand: HandProcess, cycles: int, rate_hz: float) -> dict[str, Any]:
    """The figures, what hand_io does about a lost cycle, and where they come from."""
    p50, p99, longest = np.percentile(found.round_trips_ms, (50, 99, 100))
    figures = {
        "round_trip_ms_p50": round(float(p50), 3),
        "round_trip_ms_p99": round(float(p99), 3),
        "round_trip_ms_max": round(float(longest), 3),
        "lost_cycles": found.lost + found.unsent,
    }
    return {
        "cycles": cycles,
        "rate_hz": rate_hz,
        **figures,
        "skipped_cycles": found.skipped,
        "unsent_cycles": found.unsent,
        "cpu_ms_per_cycle": round(1e3 * found.cpu_s / cycles, 3),
        "hand_cpu_ms_per_cycle": round(1e3 * hand.cpu_s / cycles, 3),  # its physics included
        "limits": LIMITS,
        "passed": all(figures[name] <= limit for name, limit in LIMITS.items()),
        "hand_io_after_a_lost_cycle": _what_hand_io_does(HandIoConfig()),
        **provenance(),
    }


def _what_hand_io_does(config: HandIoConfig) -> str:
    period_ms = 1e3 / config.set_point_hz
    return (
        f"counts it, repeats nothing: the next frame, {period_ms:.0f} ms later, has all set points; "
        f"a reading older than {config.stale_ms:.0f} ms is not valid, its motors are asked for nothing new; "
        f"a board silent for {config.silent_s:g} s puts the hand on hold, unarmed"
    )


def main(argv: list[str] | None = None) -> int:
    """Measure and print; 1 if a limit was exceeded."""
    parser = argparse.ArgumentParser(prog="python -m bench.can", description=__doc__)
    parser.add_argument("--cycles", type=int, default=10_000)
    parser.add_argument("--rate-hz", type=float, default=100.0)
    parser.add_argument("--json", action="store_true", help="one line, for other programs")
    options = parser.parse_args(argv)
    port = free_port()
    gc.freeze()
    with emulated_hand(port) as hand:
        link = CanLink(CanConfig(interface="udp_multicast", port=port))
        found = measure(link, options.cycles, options.rate_hz)
        link.close()
    if not found.round_trips_ms:
        print("no cycle was answered: does this machine pass multicast?", file=sys.stderr)
        return 1
    figures = result(found, hand, options.cycles, options.rate_hz)
    print(json.dumps(figures, indent=None if options.json else 2))
    return int(not figures["passed"])


if __name__ == "__main__":
    sys.exit(main())

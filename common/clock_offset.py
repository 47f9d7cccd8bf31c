"""How far two machines' clocks are apart: ping-pong over the bus, keeping the fastest tenth."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Protocol

from common.clock import Clock, WallClock

KEPT_SHARE = 0.1
TIMEOUT_S = 0.5
_REPLY = struct.Struct("<qq")


class Queries(Protocol):
    """The part of a bus that asks and answers."""

    def serve(self, key: str, handler: Callable[[bytes], bytes]) -> None:
        """Answer queries on `key`."""
        ...

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        """Return the first answer, or None when none came in time."""
        ...


@dataclass(frozen=True)
class Ping:
    """The four stamps of one exchange, in ns: `sent` and `back` on our clock, the others on theirs."""

    sent_ns: int
    received_ns: int
    replied_ns: int
    back_ns: int

    @property
    def rtt_ns(self) -> int:
        """Time on the way, both directions together."""
        return (self.back_ns - self.sent_ns) - (self.replied_ns - self.received_ns)

    @property
    def offset_ns(self) -> float:
        """Their clock minus ours, if both directions took equally long."""
        return ((self.received_ns - self.sent_ns) + (self.replied_ns - self.back_ns)) / 2


@dataclass(frozen=True)
class Offset:
    """Their clock minus ours; `spread_ns` is the range of the estimates that were kept."""

    offset_ns: int
    spread_ns: int
    rtt_p50_ns: int


class ClockServer:
    """Answers `clock/<name>` with the present time, for as long as the bus is open."""

    def __init__(self, bus: Queries, name: str, clock: Clock | None = None) -> None:
        self._clock = clock or WallClock()
        bus.serve(f"clock/{name}", self._answer)

    def _answer(self, _: bytes) -> bytes:
        received_ns = self._clock.now_ns()
        return _REPLY.pack(received_ns, self._clock.now_ns())


def measure_offset(bus: Queries, name: str, n: int = 50, clock: Clock | None = None) -> Offset:
    """Exchange `n` pings with the ClockServer `name`. Raises TimeoutError when it answers none of them."""
    own = clock or WallClock()
    pings = [ping for _ in range(n) if (ping := _ping(bus, name, own)) is not None]
    if not pings:
        raise TimeoutError(f"clock: {name} does not answer: start it, or check its name and cell")
    return estimate(pings)


def _ping(bus: Queries, name: str, clock: Clock) -> Ping | None:
    sent_ns = clock.now_ns()
    reply = bus.ask(f"clock/{name}", b"", TIMEOUT_S)
    back_ns = clock.now_ns()
    if reply is None or len(reply) != _REPLY.size:
        return None
    received_ns, replied_ns = _REPLY.unpack(reply)
    return Ping(sent_ns, received_ns, replied_ns, back_ns)


def estimate(pings: Sequence[Ping]) -> Offset:
    """Median offset of the tenth with the shortest way: queueing delays are one-sided, and only add."""
    by_rtt = sorted(pings, key=lambda ping: ping.rtt_ns)
    kept = [ping.offset_ns for ping in by_rtt[: max(1, round(KEPT_SHARE * len(by_rtt)))]]
    rtt_p50 = median(ping.rtt_ns for ping in by_rtt)
    return Offset(round(median(kept)), round(max(kept) - min(kept)), round(rtt_p50))

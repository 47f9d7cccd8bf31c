"""The estimator of clock offsets on exchanges whose true offset is known."""

from __future__ import annotations

import random

from common.clock_offset import Ping, estimate


def test_the_clock_offset_survives_one_sided_delays() -> None:
    draw = random.Random(0)
    true_offset_ns = 7_500_000
    pings: list[Ping] = []
    for i in range(200):
        there, back = (200_000 + round(draw.expovariate(1 / 300_000)) for _ in range(2))
        sent = i * 10_000_000
        received = sent + there + true_offset_ns
        pings.append(Ping(sent, received, received + 50_000, sent + there + 50_000 + back))
    offset = estimate(pings)
    assert abs(offset.offset_ns - true_offset_ns) < 50_000 < offset.rtt_p50_ns
    assert 0 < offset.spread_ns < 200_000
    assert estimate(pings[:1]).offset_ns == round(pings[0].offset_ns)

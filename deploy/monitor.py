"""What an operator's tool hears of a running cell: heartbeats and training figures."""

from __future__ import annotations

import time
from dataclasses import dataclass

from common.built import codec_for
from common.bus import Bus, Inbox, Input
from common.cell import SharedConfig
from common.messages import Health, Metrics
from common.topics import HEALTH, METRICS

FRESH_S = 2.0  # four heartbeats


@dataclass(frozen=True)
class Heard:
    """The newest heartbeat of a process and how long ago it came."""

    health: Health
    age_s: float
    boot_id: int

    @property
    def fresh(self) -> bool:
        """Whether the process can be taken for working."""
        return self.age_s < FRESH_S


class Monitor:
    """Keeps the newest heartbeat of every process; call `poll` often."""

    def __init__(self, bus: Bus, config: SharedConfig) -> None:
        self._bus = bus
        self._inbox = Inbox(codec_for(config.task), (Input(HEALTH), Input(METRICS, newest=True)))
        self._newest: dict[str, tuple[Health, float, int]] = {}
        for topic in (HEALTH, METRICS):
            bus.subscribe(topic, self._inbox.sink(topic))

    def poll(self) -> dict[str, Heard]:
        """Take in what has arrived and return the newest heartbeat of each process."""
        now = time.monotonic()
        self._inbox.collect(round(now * 1e9), 0)
        for sample in self._inbox.take(HEALTH):
            health: Health = sample.message
            known = self._newest.get(health.service)
            # A late joiner is sent the last heartbeat of everybody, whatever its age: it proves nothing yet.
            arrived = now if known else now - FRESH_S / 2
            self._newest[health.service] = (health, arrived, sample.header.boot_id)
        return {name: Heard(health, now - at, boot) for name, (health, at, boot) in self._newest.items()}

    @property
    def metrics(self) -> Metrics | None:
        """Figures of the newest training update, if any."""
        sample = self._inbox.newest(METRICS)
        return sample.message if sample else None

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()

    def forget(self, name: str) -> None:
        """Start anew for a process that is being restarted."""
        self._newest.pop(name, None)

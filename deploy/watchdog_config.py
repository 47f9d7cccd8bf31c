"""Options of the watchdog."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator

from common.config import Frozen


class WatchdogConfig(Frozen):
    """When a silent process is restarted; what it watches is filled in when its machine is started."""

    silent_s: float = Field(
        default=5.0, gt=1.0, description="without a heartbeat for so long a process is restarted"
    )
    patience_s: float = Field(
        default=3.0, gt=0.0, le=10.0, description="between asking it to end and signal 9"
    )
    name: str = Field(default="watchdog", description="own name on the bus; written by deploy")
    socket: Path = Field(default=Path(), description="of this machine's supervisord; written by deploy")
    watches: tuple[str, ...] = Field(default=(), description="processes of this machine; written by deploy")

    @field_validator("watches")
    @classmethod
    def _never_a_hand(cls, watches: tuple[str, ...]) -> tuple[str, ...]:
        if "hand_io" in watches:
            raise ValueError("hand_io moves a real hand: only people restart it")
        return watches

"""How a process reaches the bus."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from common.config import Frozen

LOOPBACK = "tcp/127.0.0.1:7447"
LEASE_MS = 2000


class BusConfig(Frozen):
    """Where the router is, and how patient a process is with it."""

    connect: tuple[str, ...] = Field(
        default=(LOOPBACK,), min_length=1, description="routers to dial, as tcp/HOST:PORT"
    )
    listen: tuple[str, ...] = Field(default=(LOOPBACK,), min_length=1, description="where the router listens")
    mode: Literal["client", "peer"] = Field(
        default="client",
        description="client: all traffic through the router; peer: direct links, gossiped by the router",
    )
    peer_listen: tuple[str, ...] = Field(
        default=(), description="where a peer listens for the others; mode peer only"
    )
    bind: str = Field(
        default="", description="local HOST:PORT to dial from on a machine with several networks; port 0: any"
    )
    connect_timeout_s: float = Field(
        default=10.0, gt=0, le=600, description="wait for the router at the start, then fail"
    )
    lease_ms: int = Field(
        default=LEASE_MS, ge=1000, le=60_000, description="silence after which a link is dead"
    )
    retry_ms: int = Field(
        default=200, ge=10, le=10_000, description="first pause between attempts to reconnect"
    )
    retry_max_ms: int = Field(
        default=500, ge=10, le=60_000, description="longest pause between attempts to reconnect"
    )

    @model_validator(mode="after")
    def _plausible(self) -> BusConfig:
        if self.retry_max_ms < self.retry_ms:
            raise ValueError("retry_max_ms must not be below retry_ms")
        if self.mode == "peer" and not self.peer_listen:
            raise ValueError("mode peer needs peer_listen: peers without a listener never reach each other")
        return self

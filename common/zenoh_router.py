"""Zenoh sessions with this project's settings, and the router that a cell's processes meet at."""

# Zenoh's stubs leave some methods partly untyped.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import json
from types import TracebackType
from typing import Any

import zenoh

from common.bus_config import LEASE_MS, BusConfig

REAL_TIME_BATCHES = 16  # the most that Zenoh allows
WAIT_BEFORE_DROP_US = 10_000  # a quarter of a control step
# Whatever lies in a socket goes before everything urgent: with the system's buffers of megabytes a state
# waited up to 40 ms behind a snapshot, with these 5 ms.
SOCKET_BYTES = 131_072
QUERY_TIMEOUT_MS = 5000  # bounds how long a late joiner waits for the history of a publisher that froze

# How long one batch of a blocking topic may wait for a link before that link is closed. While the router
# waits it may hold its routing tables: with Zenoh's default of 5 s, a frozen subscriber of snapshots stopped
# all traffic until it was thawed, because its lease ran out meanwhile. So: well below the lease; and clients
# are more patient than the router, so that it is the frozen link that is closed and not the sender's.
ROUTER_PATIENCE_MS = 500
CLIENT_PATIENCE_MS = 1000


class BusError(Exception):
    """The bus cannot be reached or set up; the text is one line for people."""


class Router:
    """A Zenoh router in this process, from construction to `close`; also a context manager.

    `listen` holds endpoints such as `tcp/127.0.0.1:7447` or `unixsock-stream//tmp/x/bus.sock`.
    Raises BusError when one of them cannot be opened. Sessions of one process share Zenoh's threads: beside a
    router only small messages may travel, because a latched snapshot would wait for itself.
    """

    def __init__(self, listen: tuple[str, ...], lease_ms: int = LEASE_MS) -> None:
        self.listen = listen
        settings = {
            "mode": "router",
            "listen/endpoints": list(listen),
            "listen/timeout_ms": 0,
            "listen/exit_on_failure": True,
        }
        try:
            self._session = zenoh.open(_config({**settings, **_common(lease_ms, ROUTER_PATIENCE_MS)}))
        except zenoh.ZError as error:
            raise BusError(
                f"router: cannot listen on {' '.join(listen)}: stop what uses it, or correct bus.listen "
                f"({_reason(error)})"
            ) from None

    def close(self) -> None:
        """Stop routing; safe to call twice."""
        self._session.close()

    def __enter__(self) -> Router:
        """Return the running router."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop routing."""
        self.close()


def open_session(config: BusConfig) -> zenoh.Session:
    """Dial the router and return a session that redials by itself. Raises BusError after the timeout."""
    endpoints = [f"{endpoint}#bind={config.bind}" if config.bind else endpoint for endpoint in config.connect]
    settings = {
        "mode": config.mode,
        "listen/endpoints": list(config.peer_listen),
        "connect/endpoints": endpoints,
        "connect/timeout_ms": round(config.connect_timeout_s * 1000),
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": config.retry_ms,
            "period_max_ms": config.retry_max_ms,
            "period_increase_factor": 1.5,
        },
    }
    try:
        return zenoh.open(_config({**settings, **_common(config.lease_ms, CLIENT_PATIENCE_MS)}))
    except zenoh.ZError as error:
        raise BusError(
            f"bus: no router at {' '.join(config.connect)} within {config.connect_timeout_s:g} s: "
            f"start it with `python -m deploy.router`, or correct bus.connect ({_reason(error)})"
        ) from None


def _common(lease_ms: int, patience_ms: int) -> dict[str, Any]:
    return {
        "scouting/multicast/enabled": False,
        "scouting/delay": 0,
        "transport/link/tx/lease": lease_ms,  # each side announces its own: both must be short
        "transport/link/tx/queue/congestion_control/block/wait_before_close": patience_ms * 1000,  # us
        # A warm-up sends hundreds of steps a second; with the default of 2 batches and 1 ms some are lost
        # whenever another process takes the processor.
        "transport/link/tx/queue/size/real_time": REAL_TIME_BATCHES,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": WAIT_BEFORE_DROP_US,
        # Implicit shared memory leaves files in /dev/shm, and loses queries under load.
        "transport/shared_memory/enabled": False,
        "transport/link/tcp/so_sndbuf": SOCKET_BYTES,
        "transport/link/tcp/so_rcvbuf": SOCKET_BYTES,
        "queries_default_timeout": QUERY_TIMEOUT_MS,
    }


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _reason(error: zenoh.ZError) -> str:
    """Keep the innermost cause: Zenoh's own text names source files of its build."""
    return str(error).split(" at ")[0].strip().rstrip(".")[:200]

"""Settings of the viewer."""

from __future__ import annotations

from pydantic import Field

from common.config import Frozen


class ViewerConfig(Frozen):
    """Where the dashboard is served and saved; neither page nor data have a login, so they bind locally."""

    bind: str = Field(default="127.0.0.1", description="address to listen on, and that browsers must reach")
    grpc_port: int = Field(default=9876, ge=1, le=65535, description="data")
    web_port: int = Field(default=9090, ge=1, le=65535, description="page: http://BIND:WEB_PORT")
    memory_limit_mb: int = Field(
        default=512, ge=16, description="kept for browsers that open late; the oldest data go first"
    )
    serve: bool = Field(default=True, description="host the dashboard")
    save: bool = Field(default=True, description="write <run_dir>/recording-<n>.rrd")
    period_ms: int = Field(default=100, ge=10, le=2000, description="time between updates of the dashboard")
    queue: int = Field(
        default=4096, ge=1, description="samples that may wait to be drawn; more are dropped and counted"
    )
    flush_s: float = Field(default=2.0, gt=0, description="longest wait for the file at the end")
    ghost: bool = Field(default=True, description="show the pose that the model predicts, transparent")

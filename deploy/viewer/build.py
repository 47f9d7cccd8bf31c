"""Puts the viewer together from its configuration."""

from __future__ import annotations

from common.built import Built
from common.cell import SharedConfig
from deploy.processes import PlantKind
from deploy.viewer.config import ViewerConfig
from deploy.viewer.dashboard import Dashboard
from deploy.viewer.service import ViewerService


class ViewerProcess(SharedConfig):
    """What the viewer process is started with."""

    viewer: ViewerConfig = ViewerConfig()
    plant: PlantKind = "sim"


def build(config: ViewerProcess, boot_id: int) -> Built:
    """Make the service and the dashboard that it fills."""
    period_ns = config.viewer.period_ms * 1_000_000
    canvas = Dashboard(config, config.viewer, driven=config.plant != "sim")
    return Built(ViewerService(canvas, boot_id, period_ns, config.viewer.queue))

"""Puts the viewer together from its configuration."""

from __future__ import annotations

from common.built import Built
from common.cell import SharedConfig
from common.hand_messages import PoseSource
from deploy.processes import PlantKind
from deploy.viewer.config import ViewerConfig
from deploy.viewer.dashboard import Dashboard
from deploy.viewer.service import ViewerService


class ViewerProcess(SharedConfig):
    """What the viewer process is started with."""

    viewer: ViewerConfig = ViewerConfig()
    plant: PlantKind = "sim"
    pose_source: PoseSource = PoseSource.TWIN


def build(config: ViewerProcess, boot_id: int) -> Built:
    """Make the service and the dashboard that it fills."""
    period_ns = config.viewer.period_ms * 1_000_000
    driven = config.plant != "sim"
    watched = driven and config.pose_source is PoseSource.PERCEPTION
    canvas = Dashboard(config, config.viewer, driven, watched)
    return Built(ViewerService(canvas, boot_id, period_ns, config.viewer.queue))

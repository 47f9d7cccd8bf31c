"""The dashboard's page about perception: what the camera sees, how good the pose is, and how it compares."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb

from deploy.viewer.views import recent_seconds


def camera_page(scene: Any) -> rrb.Horizontal:
    """Pictures with the die projected into them; quality, labels and times; poses beside a twin's truth."""
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin="perception/colour", name="Camera, with the die as it is believed to lie"),
        rrb.Spatial2DView(origin="perception/depth", name="Depth: nearer is brighter, black is none"),
    )
    quality = rrb.Vertical(
        recent_seconds("Quality of the pose, shares of what should be seen", "perception/quality"),
        rrb.BarChartView(origin="perception/labels", name="Probability of each of 24 labellings; 0: as told"),
        recent_seconds("From capture to pose, ms", "perception/latency_ms"),
        row_shares=[3, 2, 2],
    )
    poses = rrb.Vertical(
        scene,
        recent_seconds("Position in the palm's frame, mm: told and true", "perception/position_mm/**"),
        recent_seconds("Off the truth, mm", "perception/error_mm/**"),
        recent_seconds("Off the truth, degrees", "perception/error_deg/**"),
        row_shares=[3, 2, 1.5, 1.5],
    )
    return rrb.Horizontal(pictures, quality, poses, column_shares=[4, 4, 4], name="Camera and pose")

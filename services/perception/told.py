"""What perception's messages say of a result."""

# pyright: strict

from __future__ import annotations

import numpy as np

from common.camera_messages import PoseTracking
from common.hand_messages import ObjectPose, PoseSource
from common.message_fields import Float32
from services.perception.backend import PoseEstimate, Quality, Unseen
from services.perception.filter import Measured
from services.perception.status import Said

_NO_QUALITY: Float32 = np.zeros(4, np.float32)
_NO_LABEL: Float32 = np.zeros(24, np.float32)


def object_pose(pose: Measured, estimate: PoseEstimate) -> ObjectPose:
    """The pose in the palm's frame, with what its backend says of it."""
    return ObjectPose(
        position=pose.position.astype(np.float32),
        rotation=pose.rotation.astype(np.float32),
        covariance=pose.covariance.astype(np.float32),
        quality=_share(estimate.quality),
        label_posterior=estimate.label_posterior.astype(np.float32),
        source=PoseSource.PERCEPTION,
    )


def _share(quality: Quality) -> float:
    """How much of what is not hidden is where it should be."""
    return float(np.clip(quality.consistent / max(1e-6, 1.0 - quality.occluded), 0.0, 1.0))


def tracking(
    said: Said,
    result: PoseEstimate | Unseen | None = None,
    *,
    claimed: bool = False,
    latency_ms: float = 0.0,
    solve_ms: float = 0.0,
) -> PoseTracking:
    """State and message, and what a result adds to them."""
    found = result if isinstance(result, PoseEstimate) else None
    return PoseTracking(
        state=said.state,
        message=said.message,
        claimed=claimed,
        quality=_numbers(found.quality) if found else _NO_QUALITY,
        label_posterior=found.label_posterior.astype(np.float32) if found else _NO_LABEL,
        frame_number=result.frame_number if result else 0,
        latency_ms=latency_ms,
        solve_ms=solve_ms,
    )


def _numbers(quality: Quality) -> Float32:
    fractions = quality.consistent, quality.occluded, quality.violated, quality.pip_ncc
    return np.array(fractions, np.float32)

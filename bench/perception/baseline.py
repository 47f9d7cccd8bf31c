"""A plain ICP from the true first pose, to be compared with: geometry alone, no pips, no second look."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.perception.metrics import surface_points
from common.die import Die
from services.perception.backend import PoseEstimate, PoseState, Quality, Unseen
from services.perception.frames import Frame

Float64 = NDArray[np.float64]

REACH_M = 0.055  # points farther from the last pose's centre than a corner are not the die's
_STRIDE = 2  # of pixels
_UNKNOWN = Quality(0.0, 0.0, 0.0, 0.0)


class PlainIcp:
    """small_gicp's point-to-plane ICP of depth against the die's surface, frame to frame."""

    def __init__(self, die: Die, first: Float64) -> None:
        """Start from `first` (4, 4), the truth. Raises ImportError without small_gicp."""
        import small_gicp

        self._icp: Any = small_gicp
        dense = surface_points(die, 27)
        self._target = small_gicp.preprocess_points(dense, downsampling_resolution=0.002, num_threads=1)
        self._pose = first

    def track(self, frame: Frame) -> PoseEstimate | Unseen:
        """The pose in this frame from the one before."""
        points = self._near(frame)
        if len(points) >= 30:
            cloud, _ = self._icp.preprocess_points(points, downsampling_resolution=0.003, num_threads=1)
            result = self._icp.align(
                self._target[0],
                cloud,
                self._target[1],
                np.linalg.inv(self._pose),
                registration_type="PLANE_ICP",
                max_correspondence_distance=0.008,
                num_threads=1,
                max_iterations=20,
            )
            self._pose = np.linalg.inv(result.T_target_source)
        return PoseEstimate(
            PoseState.TRACKING,
            False,
            self._pose,
            np.eye(6),
            np.full(24, 1 / 24),
            _UNKNOWN,
            frame.t_ns,
            frame.frame_number,
        )

    def register(self, frame: Frame, mask: NDArray[np.bool_] | None = None) -> PoseEstimate | Unseen:
        """It cannot."""
        return Unseen(PoseState.LOST, "a plain ICP finds nothing", frame.t_ns, frame.frame_number)

    def adopt(self, found: PoseEstimate) -> None:
        """Follow from there."""
        self._pose = found.T_camera_die

    def reset(self) -> None:
        """Nothing to forget but the pose, which it cannot find again."""

    def _near(self, frame: Frame) -> Float64:
        """Measured points (n, 3), m, about the last pose."""
        fx, fy = frame.camera_matrix[[0, 1], [0, 1]]
        cx, cy = frame.camera_matrix[:2, 2]
        x, y, z = self._pose[:3, 3]
        rows, columns = frame.depth.shape
        half_u, half_v = REACH_M * fx / z, REACH_M * fy / z
        left, right = np.clip([x / z * fx + cx - half_u, x / z * fx + cx + half_u], 0, columns).astype(int)
        top, bottom = np.clip([y / z * fy + cy - half_v, y / z * fy + cy + half_v], 0, rows).astype(int)
        v, u = np.mgrid[top:bottom:_STRIDE, left:right:_STRIDE]
        depth = frame.depth[v, u] * frame.depth_unit_m
        points = np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth], axis=-1)
        near = (depth > 0) & (np.linalg.norm(points - self._pose[:3, 3], axis=-1) < REACH_M)
        return points[near].astype(np.float64)

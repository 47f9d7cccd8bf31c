"""A cube with a marker on each face, for the truth on hardware: in place of the die, in the same frame.

Marker n is on face n of common.die, upright as that face's pips are, in its middle.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.camera_messages import PoseState
from common.die import FACES, Die
from services.perception.backend import PoseEstimate, Quality, Unseen
from services.perception.config import CubeConfig
from services.perception.frames import Float64, Frame
from services.perception.plate import reprojection, transform_of
from services.perception.tags import Tag, TagFinder, corners_of

_NO_DISTORTION = np.zeros(5)
_MAX_PIXELS = 1.5  # reprojection error of a pose that is claimed
_CONSISTENT_M, _VIOLATED_M = 0.008, 0.012  # depth at the markers' corners, as the gate of all backends
_MIN_AREA = 0.3  # of the largest marker's: those seen flatter have edges too close to each other
_CORNER_PX = 0.15  # how exactly corners are found, one deviation
_SAME_PX = 0.5  # by which reprojection errors may differ of two tilts that are both possible
_LABEL_0 = np.eye(24)[0]  # a marker tells its face


class CubeBackend:
    """Finds the cube anew in each frame, wherever it was before."""

    def __init__(self, config: CubeConfig, die: Die) -> None:
        """Raises ValueError for markers larger than the cube's faces."""
        if config.marker_m >= die.size_m:
            raise ValueError(f"aruco.marker_m: {config.marker_m} does not fit on a face of {die.size_m} m")
        self._finder = TagFinder(config.dictionary)
        self._first = config.first
        flat = corners_of(config.marker_m)
        flat[:, 2] = die.half_m
        self._corners = flat @ die.frames  # (F, 4, 3), the die's frame
        self._follows = False

    def register(self, frame: Frame, mask: NDArray[np.bool_] | None = None) -> PoseEstimate | Unseen:
        """Find the cube where `mask` (H, W) allows it."""
        found = self._find(frame, mask)
        if isinstance(found, str):
            return Unseen(PoseState.SEARCHING, found, frame.t_ns, frame.frame_number)
        return found

    def adopt(self, found: PoseEstimate) -> None:
        """Begin to follow."""
        self._follows = True

    def track(self, frame: Frame) -> PoseEstimate | Unseen:
        """The pose in this frame; Unseen before `adopt`, and without markers."""
        found = self._find(frame, None) if self._follows else "no marker cube yet"
        if isinstance(found, str):
            state = PoseState.LOST if self._follows else PoseState.SEARCHING
            return Unseen(state, found, frame.t_ns, frame.frame_number)
        return found

    def reset(self) -> None:
        """Forget that there was one."""
        self._follows = False

    def _find(self, frame: Frame, mask: NDArray[np.bool_] | None) -> PoseEstimate | str:
        tags = [tag for tag in self._finder.find(frame.colour) if 0 <= tag.number - self._first < FACES]
        if mask is not None:
            tags = [tag for tag in tags if _within(tag, mask)]
        if not tags:
            return "no marker of the cube in view"
        areas = [cv2.contourArea(tag.pixels.astype(np.float32)) for tag in tags]
        tags = [tag for tag, area in zip(tags, areas, strict=True) if area >= _MIN_AREA * max(areas)]
        points = np.concatenate([self._corners[tag.number - self._first] for tag in tags])
        pixels = np.concatenate([tag.pixels for tag in tags])
        pose = _pose(points, pixels, frame)
        if pose is None:
            return "the markers seen fit no pose of the cube: is it the cube that is configured?"
        return _estimate(points, pixels, frame, pose)


def _within(tag: Tag, mask: NDArray[np.bool_]) -> bool:
    u, v = np.rint(tag.pixels.mean(axis=0)).astype(int)
    return bool(mask[np.clip(v, 0, mask.shape[0] - 1), np.clip(u, 0, mask.shape[1] - 1)])


def _pose(points: Float64, pixels: Float64, frame: Frame) -> Float64 | None:
    """`T_camera_die` (4, 4) of least reprojection error; of a single face's two, the one that depth says."""
    flat = len(points) == 4
    origin, axes = points.mean(axis=0), _axes(points)
    local = (points - origin) @ axes if flat else points
    camera = local, pixels, frame.camera_matrix, _NO_DISTORTION
    found, turns, moves, _ = cv2.solvePnPGeneric(
        *camera, flags=cv2.SOLVEPNP_IPPE_SQUARE if flat else cv2.SOLVEPNP_SQPNP
    )
    if not found:
        return None
    refined = [cv2.solvePnPRefineLM(*camera, t.copy(), m.copy()) for t, m in zip(turns, moves, strict=True)]
    errors = [reprojection(local, pixels, turn, move, frame.camera_matrix) for turn, move in refined]
    best = min(errors)
    poses = [transform_of(*r) for r, error in zip(refined, errors, strict=True) if error <= best + _SAME_PX]
    if flat:
        to_face = np.eye(4)
        to_face[:3, :3], to_face[:3, 3] = axes.T, -axes.T @ origin
        poses = [pose @ to_face for pose in poses]
    return min(poses, key=lambda pose: _depth_error(points, pixels, frame, pose))


def _axes(corners: Float64) -> Float64:
    """Axes (3, 3) of a face's marker as columns, right, up and outward, from its corners (4, 3)."""
    right, up = corners[1] - corners[0], corners[0] - corners[3]
    right, up = right / np.linalg.norm(right), up / np.linalg.norm(up)
    return np.stack([right, up, np.cross(right, up)], axis=1)


def _depth_error(points: Float64, pixels: Float64, frame: Frame, pose: Float64) -> float:
    behind = _behind(points, pixels, frame, pose)
    return float(np.nanmedian(np.abs(behind))) if np.isfinite(behind).any() else 0.0


def _behind(points: Float64, pixels: Float64, frame: Frame, pose: Float64) -> Float64:
    """By how much depth lies behind points (N, 3) of the cube, a little inwards: (N,) m, NaN: none."""
    inner = pixels + 0.15 * (
        pixels.reshape(-1, 4, 2).mean(axis=1, keepdims=True) - pixels.reshape(-1, 4, 2)
    ).reshape(-1, 2)
    middle = points.reshape(-1, 4, 3).mean(axis=1, keepdims=True)
    inside = points + 0.15 * (middle - points.reshape(-1, 4, 3)).reshape(-1, 3)
    height, width = frame.depth.shape
    u, v = np.rint(inner).astype(int).T
    seen = frame.depth[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)] * frame.depth_unit_m
    expected = inside @ pose[2, :3] + pose[2, 3]
    return np.where(seen > 0, seen - expected, np.nan)


def _estimate(points: Float64, pixels: Float64, frame: Frame, pose: Float64) -> PoseEstimate | str:
    turn, move = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
    error_px = reprojection(points, pixels, turn, move, frame.camera_matrix)
    if error_px > _MAX_PIXELS:
        return f"the markers seen are {error_px:.1f} px off every pose of the cube: is it the one configured?"
    behind = _behind(points, pixels, frame, pose)
    quality = Quality(
        consistent=float(np.mean(np.abs(behind) < _CONSISTENT_M)),
        occluded=float(np.mean(behind < -_CONSISTENT_M)),
        violated=float(np.mean(behind > _VIOLATED_M)),
        pip_ncc=1.0,
    )
    claimed = quality.violated < 0.5 and quality.occluded < 0.5
    return PoseEstimate(
        state=PoseState.TRACKING if claimed else PoseState.SUSPECT,
        claimed=claimed,
        T_camera_die=pose,
        covariance=_covariance(points, frame.camera_matrix, pose),
        label_posterior=_LABEL_0,
        quality=quality,
        t_ns=frame.t_ns,
        frame_number=frame.frame_number,
    )


def _covariance(points: Float64, camera_matrix: Float64, pose: Float64) -> Float64:
    """Of (dp, dw), from errors of the corners in pixels to first order."""
    arms = points @ pose[:3, :3].T
    x, y, z = (arms + pose[:3, 3]).T
    zero = np.zeros_like(z)
    along_u = camera_matrix[0, 0] * np.stack([1 / z, zero, -x / z**2], axis=1)
    along_v = camera_matrix[1, 1] * np.stack([zero, 1 / z, -y / z**2], axis=1)
    slopes = np.concatenate([along_u, along_v])
    # A turn dw moves a point by dw x arm; slope · (dw x arm) = dw · (arm x slope).
    jacobian = np.concatenate([slopes, np.cross(np.concatenate([arms, arms]), slopes)], axis=1)
    return np.asarray(_CORNER_PX**2 * np.linalg.inv(jacobian.T @ jacobian), np.float64)

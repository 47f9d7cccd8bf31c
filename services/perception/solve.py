"""Camera to palm: from a plate in a jig, or from a plate and an arm (A X = Z B).

With an arm, either the camera rides with the palm and the plate stands still (`hand_eye`), or the camera
stands still and the plate rides with the palm (`robot_world`). Both are T_i = L · P_i · R: T_i where the
camera sees the plate in view i, P_i known from the arm, L and R sought. Letters: N views, C corners.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from services.perception import rigid
from services.perception.calibration import Residuals
from services.perception.frames import Float64
from services.perception.plate import Plate, View

MIN_VIEWS = 6  # with an arm; three determine it, the others show whether they agree
MIN_TURN_DEG = 30.0
MIN_SEEN = 0.5  # a corner of a jig's plate counts if so many of the views have it

_Start = Callable[[Sequence[View], list[Float64]], tuple[Float64, Float64]]


class SolveError(ValueError):
    """Views that do not determine where the camera is; the text says what to do."""


@dataclass(frozen=True)
class Solved:
    """Where the camera is: (4, 4), in the palm's frame or, of `robot_world`, in the arm's base."""

    T_frame_camera: Float64
    residuals: Residuals


# --- the plate in a jig ---------------------------------------------------------------------------


def solve_jig(views: Sequence[View], plate: Plate, camera_matrix: Float64, T_palm_plate: Float64) -> Solved:
    """Camera in the palm's frame from N views of a plate that did not move. Raises SolveError."""
    if not views:
        raise SolveError("no view shows the plate")
    ids, pixels = _median_corners(views)
    pose = plate.pose(ids, pixels, camera_matrix)
    if isinstance(pose, str):
        raise SolveError(f"all views together: {pose}")
    T_camera_plate, rms_px = pose
    offsets = [_offset(view.T_camera_plate, T_camera_plate) for view in views]
    return Solved(T_palm_plate @ rigid.inverse(T_camera_plate), _residuals(rms_px, offsets))


def _median_corners(views: Sequence[View]) -> tuple[Any, Float64]:
    """The corners seen in most views, each at the median of where it was seen: ids (C,), pixels (C, 2)."""
    everywhere = np.concatenate([view.ids for view in views])
    pixels = np.concatenate([view.pixels for view in views])
    ids, counts = np.unique(everywhere, return_counts=True)
    ids = ids[counts >= MIN_SEEN * len(views)]
    if not len(ids):
        raise SolveError("no corner is in most of the views: has the plate or the camera moved?")
    return ids, np.stack([np.median(pixels[everywhere == number], axis=0) for number in ids])


# --- with an arm ----------------------------------------------------------------------------------


def solve_hand_eye(
    views: Sequence[View], T_base_palm: Sequence[Float64], plate: Plate, camera_matrix: Float64
) -> Solved:
    """Camera in the palm's frame: it rides with the palm, the plate stands still. Raises SolveError."""
    _check_views(views, T_base_palm)
    arm = [rigid.inverse(pose) for pose in T_base_palm]
    problem = _Problem(views, arm, plate, camera_matrix, _start_hand_eye)
    return Solved(rigid.inverse(problem.left), problem.residuals())


def solve_robot_world(
    views: Sequence[View], T_base_palm: Sequence[Float64], plate: Plate, camera_matrix: Float64
) -> Solved:
    """Camera in the arm's base: it stands still, the plate rides with the palm. Raises SolveError."""
    _check_views(views, T_base_palm)
    problem = _Problem(views, list(T_base_palm), plate, camera_matrix, _start_robot_world)
    return Solved(rigid.inverse(problem.left), problem.residuals())


def _check_views(views: Sequence[View], poses: Sequence[Float64]) -> None:
    if len(views) < MIN_VIEWS:
        raise SolveError(f"{len(views)} views show the plate, {MIN_VIEWS} wanted")
    turns = np.array([_rotation_vector(poses[0][:3, :3].T @ pose[:3, :3]) for pose in poses])
    axes = np.linalg.svd(turns - turns.mean(axis=0))[2]
    ranges = np.degrees(np.ptp(turns @ axes.T, axis=0))
    if ranges[1] < MIN_TURN_DEG:
        raise SolveError(
            f"the palm turned by {ranges[0]:.0f} and {ranges[1]:.0f} degrees about two axes, "
            f"{MIN_TURN_DEG:.0f} wanted about both: add views with the palm turned another way"
        )


class _Problem:
    """T_i = L · P_i · R, by one of OpenCV's closed forms.

    Refining L and R to the least reprojection error made them worse, 1.1 mm instead of 0.4: it is the arm
    that errs, not the pixels (15 views, arm with 0.3 mm and 0.03 deg).
    """

    def __init__(
        self, views: Sequence[View], arm: list[Float64], plate: Plate, camera_matrix: Float64, start: _Start
    ) -> None:
        self._views, self._arm, self._start = views, arm, start
        self._plate, self._camera_matrix = plate, camera_matrix
        self.left, self._right = start(views, arm)

    def residuals(self) -> Residuals:
        """Of all views together in px, and of each view from what the others say of it."""
        squares = [self._squared_px(view, pose) for view, pose in zip(self._views, self._arm, strict=True)]
        rms_px = float(np.sqrt(np.mean(np.concatenate(squares))))
        return _residuals(rms_px, [self._left_out(i) for i in range(len(self._views))])

    def _squared_px(self, view: View, pose: Float64) -> Float64:
        T_camera_plate = self.left @ pose @ self._right
        points = self._plate.corners(view.ids) @ T_camera_plate[:3, :3].T + T_camera_plate[:3, 3]
        seen = points @ self._camera_matrix.T
        return np.sum((seen[:, :2] / seen[:, 2:] - view.pixels) ** 2, axis=1)

    def _left_out(self, view: int) -> tuple[float, float]:
        others = [i for i in range(len(self._views)) if i != view]
        left, right = self._start([self._views[i] for i in others], [self._arm[i] for i in others])
        return _offset(self._views[view].T_camera_plate, left @ self._arm[view] @ right)


def _start_hand_eye(views: Sequence[View], arm: list[Float64]) -> tuple[Float64, Float64]:
    """Park and Martin's closed form (1994)."""
    palms, plates = [rigid.inverse(pose) for pose in arm], [view.T_camera_plate for view in views]
    # By keyword: in OpenCV 4 the fifth positional argument is an output.
    turn, move = cv2.calibrateHandEye(*_apart(palms), *_apart(plates), method=cv2.CALIB_HAND_EYE_PARK)
    left = rigid.inverse(_together(turn, move))
    return left, _mean([rigid.inverse(left @ pose) @ T for pose, T in zip(arm, plates, strict=True)])


def _start_robot_world(views: Sequence[View], arm: list[Float64]) -> tuple[Float64, Float64]:
    """Shah's closed form (2013). What OpenCV calls world, base and gripper are plate, palm and base here."""
    plates = [view.T_camera_plate for view in views]
    turn, move, left_turn, left_move = cv2.calibrateRobotWorldHandEye(
        *_apart(plates), *_apart(arm), method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH
    )
    return _together(left_turn, left_move), rigid.inverse(_together(turn, move))


def _apart(transforms: Sequence[Float64]) -> tuple[Any, Any]:
    return [t[:3, :3] for t in transforms], [t[:3, 3] for t in transforms]


def _together(turn: Any, move: Any) -> Float64:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn, np.ravel(move)
    return transform


def _mean(transforms: Sequence[Float64]) -> Float64:
    """The mean (4, 4) of poses that nearly agree."""
    mean = np.mean(transforms, axis=0)
    return rigid.join(mean[:3, 3], rigid.from_matrix(mean[:3, :3]))


def _rotation_vector(matrix: Float64) -> Float64:
    return np.ravel(np.asarray(cv2.Rodrigues(matrix)[0], np.float64))


def _offset(seen: Float64, expected: Float64) -> tuple[float, float]:
    """How far apart two poses are: mm, degrees."""
    turn = _rotation_vector(seen[:3, :3].T @ expected[:3, :3])
    distance = float(np.linalg.norm(seen[:3, 3] - expected[:3, 3]))
    return 1e3 * distance, float(np.degrees(np.linalg.norm(turn)))


def _residuals(rms_px: float, offsets: Sequence[tuple[float, float]]) -> Residuals:
    position_mm, rotation_deg = np.sqrt(np.mean(np.square(offsets), axis=0))
    return Residuals(
        views=len(offsets),
        pixels_rms=rms_px,
        position_mm=float(position_mm),
        rotation_deg=float(rotation_deg),
    )

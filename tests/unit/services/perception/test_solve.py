"""Calibration from synthetic pictures of a plate, with the camera's true place known."""

import cv2
import numpy as np
import pytest

from common import geometry
from services.perception import rigid
from services.perception.plate import Plate, PlateConfig
from services.perception.solve import SolveError, solve_hand_eye, solve_jig, solve_robot_world
from tests.unit.services.perception.flat import CAMERA_MATRIX, looking, plate_picture

PLATE = Plate(PlateConfig())
T_PALM_PLATE = rigid.join((0.05, -0.02, 0.16), (0.5, 0.5, -0.5, 0.5))
MIDDLE = np.array([0.105, 0.075, 0.0])


def seen(T_camera_plate, seed=0):
    return PLATE.look(plate_picture(PLATE, T_camera_plate, seed=seed), CAMERA_MATRIX)


def around(rng, distance_m=0.42):
    """A camera on the plate's printed side, 15 to 45 degrees off its normal, rolled at will."""
    tilt, about = rng.uniform(0.26, 0.78), rng.uniform(-np.pi, np.pi)
    direction = [np.sin(tilt) * np.cos(about), np.sin(tilt) * np.sin(about), -np.cos(tilt)]
    return looking(MIDDLE + distance_m * np.array(direction), MIDDLE, rng.uniform(-0.5, 0.5))


def offset(seen, expected):
    turn = cv2.Rodrigues(seen[:3, :3].T @ expected[:3, :3])[0]
    return 1e3 * np.linalg.norm(seen[:3, 3] - expected[:3, 3]), np.degrees(np.linalg.norm(turn))


def trembling(rng, pose, position_m=0.0003, rotation_rad=0.0005):
    """What an arm tells of a pose."""
    turn = geometry.from_axis_angle(rng.normal(size=3), np.asarray(rng.normal(0, rotation_rad)))
    return rigid.join(rng.normal(0, position_m, 3), turn) @ pose


@pytest.fixture(scope="module")
def views():
    """Twelve views and the true poses of the plate in them."""
    rng = np.random.default_rng(11)
    poses = [around(rng) for _ in range(12)]
    return poses, [seen(pose, number) for number, pose in enumerate(poses)]


def test_a_view_tells_where_the_plate_is(views):
    for pose, view in zip(*views, strict=True):
        position_mm, rotation_deg = offset(view.T_camera_plate, pose)
        assert position_mm < 0.4 and rotation_deg < 0.1
        assert view.rms_px < 0.2 and len(view.ids) == 24


def test_the_jig_gives_the_camera_in_the_palms_frame():
    T_camera_plate = around(np.random.default_rng(4))
    views = [seen(T_camera_plate, seed) for seed in range(6)]
    solved = solve_jig(views, PLATE, CAMERA_MATRIX, T_PALM_PLATE)
    expected = T_PALM_PLATE @ rigid.inverse(T_camera_plate)
    position_mm, rotation_deg = offset(solved.T_frame_camera, expected)
    assert position_mm < 0.3 and rotation_deg < 0.05
    assert solved.residuals.views == 6
    assert solved.residuals.pixels_rms < 0.2
    assert solved.residuals.position_mm < 0.2 and solved.residuals.rotation_deg < 0.05


def test_a_plate_that_moved_in_its_jig_shows_in_the_residuals():
    pose = around(np.random.default_rng(4))
    moved = rigid.join((0.004, 0, 0), (1, 0, 0, 0)) @ pose
    views = [seen(pose, 0), seen(pose, 1), seen(pose, 2), seen(moved, 3), seen(moved, 4)]
    assert solve_jig(views, PLATE, CAMERA_MATRIX, T_PALM_PLATE).residuals.position_mm > 2.0


def test_a_camera_that_rides_with_the_palm(views):
    """Exact arm: exact answer. An arm with 0.3 mm and 0.03 deg of error: 1.5 mm and 0.15 deg."""
    poses, seen_views = views
    rng = np.random.default_rng(21)
    T_palm_camera = rigid.join((0.08, 0.03, -0.05), geometry.normalise(rng.normal(size=4)))
    T_base_plate = rigid.join((0.5, 0.1, 0.02), geometry.normalise(rng.normal(size=4)))
    arm = [T_base_plate @ rigid.inverse(T_palm_camera @ pose) for pose in poses]
    exact = solve_hand_eye(seen_views, arm, PLATE, CAMERA_MATRIX)
    assert offset(exact.T_frame_camera, T_palm_camera) < (0.3, 0.05)
    assert exact.residuals.position_mm < 0.5 and exact.residuals.rotation_deg < 0.1
    told = [trembling(rng, pose) for pose in arm]
    solved = solve_hand_eye(seen_views, told, PLATE, CAMERA_MATRIX)
    position_mm, rotation_deg = offset(solved.T_frame_camera, T_palm_camera)
    assert position_mm < 1.5 and rotation_deg < 0.15
    assert 0.2 < solved.residuals.position_mm < 3.0


def test_a_camera_that_stands_still_and_a_plate_on_the_hand(views):
    poses, seen_views = views
    rng = np.random.default_rng(22)
    T_base_camera = rigid.join((0.7, -0.4, 0.6), geometry.normalise(rng.normal(size=4)))
    T_palm_plate = rigid.join((0.03, 0.01, 0.09), geometry.normalise(rng.normal(size=4)))
    arm = [T_base_camera @ pose @ rigid.inverse(T_palm_plate) for pose in poses]
    exact = solve_robot_world(seen_views, arm, PLATE, CAMERA_MATRIX)
    assert offset(exact.T_frame_camera, T_base_camera) < (0.3, 0.05)
    solved = solve_robot_world(seen_views, [trembling(rng, pose) for pose in arm], PLATE, CAMERA_MATRIX)
    position_mm, rotation_deg = offset(solved.T_frame_camera, T_base_camera)
    assert position_mm < 1.5 and rotation_deg < 0.15  # the base is 1 m away


def test_one_wrong_pose_of_the_arm_shows_in_the_residuals(views):
    poses, seen_views = views
    arm = [rigid.inverse(pose) for pose in poses]
    arm[3] = rigid.join((0.02, 0, 0), (1, 0, 0, 0)) @ arm[3]
    assert solve_hand_eye(seen_views, arm, PLATE, CAMERA_MATRIX).residuals.position_mm > 3.0


def test_views_that_determine_nothing_are_refused_with_what_to_do(views):
    poses, seen_views = views
    arm = [rigid.inverse(pose) for pose in poses]
    with pytest.raises(SolveError, match="5 views show the plate, 6 wanted"):
        solve_hand_eye(seen_views[:5], arm[:5], PLATE, CAMERA_MATRIX)
    one_axis = [
        rigid.join((0, 0, 0), geometry.from_axis_angle(np.array([0.0, 0, 1]), np.asarray(0.1 * n)))
        for n in range(12)
    ]
    with pytest.raises(SolveError, match="63 and 0 degrees about two axes, 30 wanted about both"):
        solve_robot_world(seen_views, one_axis, PLATE, CAMERA_MATRIX)
    with pytest.raises(SolveError, match="no view shows the plate"):
        solve_jig([], PLATE, CAMERA_MATRIX, T_PALM_PLATE)


def test_pictures_that_cannot_be_used_say_why():
    T_camera_plate = around(np.random.default_rng(4))
    sharp = plate_picture(PLATE, T_camera_plate)
    assert PLATE.look(cv2.GaussianBlur(sharp, (0, 0), 1.7), CAMERA_MATRIX).startswith("blurred: sharpness")
    assert PLATE.look(np.zeros_like(sharp), CAMERA_MATRIX) == "0 corners seen, 8 wanted"
    wrong = CAMERA_MATRIX * np.array([[0.7, 1, 1], [1, 1, 1], [1, 1, 1]])
    assert "px off the best pose" in PLATE.look(sharp, wrong)
    flat = looking(MIDDLE - (0, 0, 0.5), MIDDLE)
    assert "its tilt cannot be told" in seen(flat)

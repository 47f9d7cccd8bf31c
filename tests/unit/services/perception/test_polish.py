"""The gate for poses of other backends: right ones pass and get better, slipped and shifted ones do not."""

import cv2
import numpy as np
import pytest

from common import geometry
from common.camera_messages import PoseState
from common.die import CUBE_ROTATIONS, DIE
from services.perception import rigid
from services.perception.polish import Polisher
from tests.unit.services.perception.cubes import frame
from tests.unit.services.perception.driven import HELD


@pytest.fixture(scope="module")
def polisher():
    return Polisher(DIE)


def moved(position=(0, 0, 0), degrees=0.0):
    turn = geometry.from_axis_angle(np.array([0.3, 1.0, -0.4]), np.asarray(np.radians(degrees)))
    offset = rigid.join((0, 0, 0), turn)
    pose = HELD.copy()
    pose[:3, :3] = offset[:3, :3] @ HELD[:3, :3]
    pose[:3, 3] += position
    return pose


def offset(told):
    turn = cv2.Rodrigues(told[:3, :3].T @ HELD[:3, :3])[0]
    return 1e3 * np.linalg.norm(told[:3, 3] - HELD[:3, 3]), np.degrees(np.linalg.norm(turn))


@pytest.mark.parametrize("start", [moved(), moved((0.003, -0.002, 0.002)), moved(degrees=4.0)])
def test_a_pose_that_is_nearly_right_is_refined_and_claimed(polisher, start):
    found = polisher.judge(frame(HELD, pips=True), start)
    position_mm, rotation_deg = offset(found.T_camera_die)
    assert found.claimed and found.state is PoseState.TRACKING
    assert position_mm < 1.0 and rotation_deg < 1.5
    assert found.quality.consistent > 0.9 and found.label_posterior[0] > 0.99


def test_a_pose_whose_faces_have_slipped_is_not_claimed_and_the_right_labels_are_told(polisher):
    slipped = HELD.copy()
    slipped[:3, :3] = HELD[:3, :3] @ CUBE_ROTATIONS[7]
    found = polisher.judge(frame(HELD, pips=True), slipped)
    assert not found.claimed and found.state is PoseState.SUSPECT
    best = int(np.argmax(found.label_posterior))
    told = found.T_camera_die.copy()
    told[:3, :3] = told[:3, :3] @ CUBE_ROTATIONS[best]
    assert found.label_posterior[best] > 0.9 and offset(told)[1] < 1.5


@pytest.mark.parametrize(
    "start", [moved((0.03, 0, 0)), moved((0, 0, 0.05)), moved(degrees=30.0), moved((2, 0, 0))]
)
def test_a_pose_beside_the_die_is_not_claimed(polisher, start):
    found = polisher.judge(frame(HELD, pips=True), start)
    assert not found.claimed and found.state is PoseState.SUSPECT


def test_nothing_where_the_die_should_be_is_not_claimed(polisher):
    found = polisher.judge(frame(None), HELD)
    assert not found.claimed and found.quality.violated > 0.9

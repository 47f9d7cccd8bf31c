"""A knocked camera is noticed from the palm's tag, and nothing else is taken for one."""

import cv2
import numpy as np
import pytest

from common import geometry
from services.perception import rigid
from services.perception.calibration import TagReference
from services.perception.config import KnockConfig
from services.perception.palm_tag import Mount, PalmTag
from services.perception.tags import TagFinder, dictionary_of
from tests.unit.services.perception.flat import CAMERA_MATRIX, HEIGHT, blank, developed, lay, looking

TAG_M, NUMBER = 0.025, 7
HERE = looking((0.05, 0.1, -0.42), (0.03, 0.0, 0.0))


def picture(T_camera_tag=HERE, number=NUMBER, seed=0):
    canvas = blank()
    marker = cv2.aruco.generateImageMarker(dictionary_of("DICT_4X4_50"), number, 60)
    paper = np.pad(marker, 12, constant_values=255)
    lay(canvas, paper, T_camera_tag, (TAG_M * 1.4, TAG_M * 1.4), centred=True)
    return developed(canvas, noise=2.0, seed=seed)


def corners(T_camera_tag=HERE):
    """Where the corners of the black square truly are."""
    half = TAG_M / 2
    points = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    seen = (points @ T_camera_tag[:3, :3].T + T_camera_tag[:3, 3]) @ CAMERA_MATRIX.T
    return seen[:, :2] / seen[:, 2:]


def knocked(degrees, position=(0, 0, 0)):
    turn = geometry.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.asarray(np.radians(degrees)))
    return rigid.join(position, turn) @ HERE


@pytest.fixture
def tag():
    reference = TagReference(number=NUMBER, corners_px=[tuple(c) for c in corners().tolist()])
    return PalmTag(reference, KnockConfig(looks=3))


def test_corners_are_found_to_a_third_of_a_pixel():
    (found,) = TagFinder("DICT_4X4_50").find(picture())
    assert found.number == NUMBER
    assert found.pixels == pytest.approx(corners(), abs=0.33)


def test_a_camera_that_stays_is_steady_after_three_looks(tag):
    assert [tag.look(picture(seed=n)) for n in range(4)] == [Mount.UNKNOWN] * 2 + [Mount.STEADY] * 2
    assert tag.message() == "" and tag.offset_px < 0.3


@pytest.mark.parametrize("moved", [knocked(0.4), knocked(-0.4), knocked(0, (0.003, 0, 0))])
def test_a_knock_of_less_than_half_a_degree_is_noticed(tag, moved):
    for seed in range(3):
        tag.look(picture(seed=seed))
    assert [tag.look(picture(moved, seed=n)) for n in range(3)] == [Mount.STEADY] * 2 + [Mount.KNOCKED]
    assert "camera knocked: the palm's tag is 4." in tag.message()
    assert tag.message().endswith("fix the camera and run calibrate again")


@pytest.mark.parametrize("degrees", [2, 4, 6, 10, 15, -4, -15])
def test_a_knock_that_moves_the_tag_far_away_is_noticed(tag, degrees):
    for seed in range(3):
        tag.look(picture(seed=seed))
    moved = knocked(degrees)
    assert [tag.look(picture(moved, seed=n)) for n in range(3)] == [Mount.STEADY] * 2 + [Mount.KNOCKED]
    off_px = np.linalg.norm(corners(moved) - corners(), axis=1).mean()
    assert tag.offset_px == pytest.approx(off_px, abs=0.5)


def test_far_away_from_the_start_it_is_no_steady_camera(tag):
    assert [tag.look(picture(knocked(8), seed=n)) for n in range(3)][-1] is Mount.KNOCKED


@pytest.mark.parametrize("before, verdict", [(0, Mount.UNKNOWN), (3, Mount.STEADY)])
def test_a_tag_that_nobody_sees_any_more_is_said_until_it_is_judged_again(before, verdict):
    reference = TagReference(number=NUMBER, corners_px=[tuple(c) for c in corners().tolist()])
    tag = PalmTag(reference, KnockConfig(looks=3, unseen_looks=5))
    for _ in range(before):
        tag.look(picture())
    away = np.full((HEIGHT, 640, 3), 90, np.uint8)
    assert [tag.look(away) for _ in range(5)] == [verdict] * 4 + [Mount.UNSEEN]
    assert tag.message().startswith("the palm's tag was not seen in 5 looks: is it covered, or")
    assert [tag.look(picture()) for _ in range(3)] == [Mount.UNSEEN] * 2 + [Mount.STEADY]
    assert tag.message() == ""


def test_a_camera_that_is_put_back_is_steady_again(tag):
    for picture_seen in [picture(knocked(0.5))] * 3 + [picture()] * 3:
        tag.look(picture_seen)
    assert tag.mount is Mount.STEADY


def test_hidden_doubled_or_foreign_tags_decide_nothing(tag):
    hidden = np.full((HEIGHT, 640, 3), 90, np.uint8)
    for _ in range(5):
        assert tag.look(hidden) is Mount.UNKNOWN
        assert tag.look(picture(number=NUMBER + 1)) is Mount.UNKNOWN
    for _ in range(3):
        tag.look(picture(knocked(0.5)))
    assert tag.look(hidden) is Mount.KNOCKED  # the last verdict holds


def test_a_single_wrong_look_decides_nothing(tag):
    for moved in (0, 0, 0, 0.5, 0.5, 0, 0.5, 0.5):
        tag.look(picture(knocked(moved)))
    assert tag.mount is Mount.STEADY

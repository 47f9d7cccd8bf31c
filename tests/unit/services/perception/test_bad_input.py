"""What a camera may send that is no use: each has a state, a message that says what to do, and a count."""

from dataclasses import replace

import numpy as np
import pytest

from common.camera_config import CameraConfig
from common.die import Die
from services.perception import rigid
from services.perception.config import KnockConfig
from services.perception.palm_tag import PalmTag
from services.perception.swapped import red_and_blue_swapped
from services.perception.worker import SWAPPED
from tests.unit.services.perception.cubes import frame
from tests.unit.services.perception.driven import FRAME_NS, HELD, LATENCY_NS, DrivenPerception
from tests.unit.services.perception.flat import CAMERA_MATRIX
from tests.unit.services.perception.test_palm_tag import TagReference, corners, knocked, picture
from tests.unit.services.perception.test_service import ScriptedBackend


def fed(driven, change, count=20):
    """Pictures of the held cube, each changed."""
    for _ in range(count):
        driven.number += 1
        taken = frame(HELD, driven.number, driven.now_ns + FRAME_NS - LATENCY_NS)
        driven.show(change(taken))
    return driven.said


def without_depth(taken):
    return replace(taken, depth=np.zeros_like(taken.depth))


def with_another_k(taken):
    return replace(taken, camera_matrix=CAMERA_MATRIX * np.array([[1.5], [1.5], [1.0]]))


def from_yesterday(taken):
    return replace(
        taken, colour_time_ns=taken.colour_time_ns - 10**14, depth_time_ns=taken.depth_time_ns - 10**14
    )


def from_tomorrow(taken):
    return replace(
        taken, colour_time_ns=taken.colour_time_ns + 10**14, depth_time_ns=taken.depth_time_ns + 10**14
    )


def torn(taken):
    return replace(taken, depth_time_ns=taken.depth_time_ns - 40_000_000)


@pytest.mark.parametrize(
    "change, fault, message",
    [
        (without_depth, "no_depth", "depth in 0% of the picture: is the lens covered or the emitter off?"),
        (with_another_k, "camera", "another K than calibrated"),
        (from_tomorrow, "age", "from 100000.0 s ahead: do the clocks of camera and perception agree?"),
        (torn, "order", "colour is +40.0 ms from depth"),
    ],
)
def test_pictures_that_are_unfit_are_refused_counted_and_end_in_lost(change, fault, message):
    driven = DrivenPerception().tracked()
    assert fed(driven, change, 12).state == "suspect"
    said = fed(driven, change, 28)
    assert said.state == "lost" and message in said.message
    assert driven.poses == [] and driven.fields[f"refused_{fault}"] == 40
    for _ in range(4):
        driven.see()
    assert driven.said.state == "tracking" and driven.poses[-1].header.valid


@pytest.mark.parametrize("followed, state", [(True, "lost"), (False, "searching")])
def test_a_refused_picture_does_not_hide_the_silence_after_it(followed, state):
    driven = DrivenPerception().tracked() if followed else DrivenPerception()
    driven.wait(0.5)
    fed(driven, torn, 1)
    driven.wait(1.5)
    assert driven.said.state == state
    assert driven.said.message.startswith("no picture for 1.")
    assert driven.said.message.endswith("is the camera unplugged?")


def test_time_that_runs_backwards_is_refused():
    driven = DrivenPerception().tracked()
    said = fed(driven, from_yesterday, 40)
    assert said.state == "lost" and "was not captured after" in said.message
    assert driven.fields["refused_order"] == 40


def test_a_first_picture_from_yesterday_is_refused():
    driven = DrivenPerception()
    said = fed(driven, from_yesterday, 3)
    assert said.state == "searching" and "picture is 100000.0 s old" in said.message


def test_a_stuck_camera_is_noticed_although_its_time_goes_on():
    driven = DrivenPerception().tracked()
    last = frame(HELD, 5, 0)

    def again(taken):
        return replace(last, colour_time_ns=taken.colour_time_ns, depth_time_ns=taken.depth_time_ns)

    said = fed(driven, again, 40)
    assert said.state == "lost" and "the same picture again and again" in said.message
    assert len(driven.poses) == 1 and driven.fields["refused_stuck"] == 39


def test_a_second_cube_beyond_the_hands_reach_is_not_searched():
    driven = DrivenPerception(reach={"radius_m": 0.12})
    beside = rigid.join((0.17, 0.0, 0.0), (1, 0, 0, 0)) @ HELD
    for _ in range(6):
        driven.see(None, second=beside)
    assert driven.said.state == "searching" and not driven.poses
    for _ in range(3):
        driven.see(HELD, second=None)
    assert driven.said.state == "tracking"


def test_a_die_far_from_the_hand_is_not_claimed():
    far = DrivenPerception(reach={"believed_m": 0.06})
    for _ in range(4):
        far.see(rigid.join((0.0, 0.0, -0.1), (1, 0, 0, 0)) @ HELD)
    assert far.said.state == "suspect" and "take it out of view" in far.said.message
    assert not any(sample.header.valid for sample in far.poses)


RED = Die(body_rgb=(176, 28, 34), pip_rgb=(240, 238, 232))


def painted(rgb, light=1.0):
    colour = np.full((480, 640, 3), 90, np.uint8)
    colour[200:260, 300:360] = np.clip(np.array(rgb) * light, 0, 255)
    return colour


@pytest.mark.parametrize("light", [0.6, 1.0, 1.3])
def test_swapped_channels_show_on_a_coloured_die_in_any_light(light):
    assert red_and_blue_swapped(painted(RED.body_rgb[::-1], light), RED)
    assert not red_and_blue_swapped(painted(RED.body_rgb, light), RED)
    assert not red_and_blue_swapped(painted((90, 90, 90), light), RED)


def test_on_a_grey_die_swapped_channels_cannot_be_told_and_do_not_matter():
    """The markers are black and white: the poses are the same."""
    assert not red_and_blue_swapped(painted((230, 236, 236)), Die())
    plain, swapped = (DrivenPerception() for _ in range(2))
    for number in range(4):
        taken = frame(HELD, number + 1, plain.now_ns + FRAME_NS - LATENCY_NS)
        plain.show(taken)
        swapped.show(replace(taken, colour=np.ascontiguousarray(taken.colour[..., ::-1])))
    poses = [driven.poses[-1].message.position for driven in (plain, swapped)]
    assert np.allclose(*poses, atol=1e-4)


def test_swapped_channels_are_said_and_nothing_is_claimed():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend, knock={"period_s": 0.01}).tracked()
    driven.service._worker._die = RED
    blue = painted(RED.body_rgb[::-1])
    fed(driven, lambda taken: replace(taken, colour=blue + taken.colour // 8), 3)
    assert driven.said.state == "suspect" and driven.said.message == SWAPPED
    assert not driven.poses[-1].header.valid


@pytest.mark.parametrize("degrees", [0.5, 8.0])
def test_a_knocked_camera_is_said_and_nothing_is_claimed(degrees):
    reference = TagReference(number=7, corners_px=[tuple(c) for c in corners().tolist()])
    tag = PalmTag(reference, KnockConfig(looks=2))
    driven = DrivenPerception(ScriptedBackend(), tag=tag, knock={"period_s": 0.01}).tracked()

    def seen_from(camera):
        return lambda taken: replace(taken, colour=picture(camera, seed=taken.frame_number))

    fed(driven, seen_from(knocked(0.0)), 4)
    assert driven.said.state == "tracking" and driven.poses[-1].header.valid
    fed(driven, seen_from(knocked(degrees)), 4)
    assert driven.said.state == "suspect" and driven.said.message.startswith("camera knocked")
    assert not driven.poses[-1].header.valid and driven.fields["knocked"] == 1
    fed(driven, seen_from(knocked(0.0)), 4)
    assert driven.said.state == "tracking" and driven.poses[-1].header.valid


def test_the_emulated_cameras_pose_looks_at_the_die_with_the_fingers_up():
    config = CameraConfig()
    T_camera_palm = rigid.inverse(config.T_palm_camera)
    target = T_camera_palm[:3, :3] @ np.array(config.target_m) + T_camera_palm[:3, 3]
    assert target[:2] == pytest.approx([0, 0], abs=1e-9) and 0.35 < target[2] < 0.5
    fingertips = T_camera_palm[:3, :3] @ np.array([0.0, 0.0, 1.0])
    assert fingertips[1] < -0.8 and abs(fingertips[0]) < 1e-9  # up in the picture

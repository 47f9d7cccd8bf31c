"""A second die like the first one: not claimed in its place, neither by a jump nor after a loss."""

from dataclasses import replace

import numpy as np
import pytest

from common.die import DIE
from services.perception import rigid
from services.perception.cpu.backend import CpuBackend
from services.perception.filter import Measured
from services.perception.last_place import ElsewhereConfig, LastPlace
from tests.unit.services.perception.cpu.raycast import photograph, transform
from tests.unit.services.perception.driven import FRAME_NS, HELD, LATENCY_NS, T_PALM_CAMERA, DrivenPerception
from tests.unit.services.perception.test_service import ScriptedBackend

FIRST = transform((0.0, 0.0, 0.42), (1.0, 2.0, 0.3), 40.0)
SECOND = transform((0.09, 0.0, 0.42), (0.2, 1.0, 0.5), 70.0)


def seen(t_s, x_m):
    return Measured(round(1e9 * t_s), np.array([x_m, 0.0, 0.0]), np.array([1.0, 0, 0, 0]), np.eye(6))


@pytest.fixture
def place():
    place = LastPlace(ElsewhereConfig(distance_m=0.02, speed_m_s=0.25, doubt_s=1.0))
    place.claimed(seen(10.0, 0.1))
    return place


@pytest.mark.parametrize(
    "t_s, x_m, possible", [(10.5, 0.244, True), (10.5, 0.246, False), (10.5, -0.046, False)]
)
def test_a_die_may_be_as_far_as_it_can_have_gone(place, t_s, x_m, possible):
    assert (place.doubt(seen(t_s, x_m)) == "") is possible


def test_the_doubt_is_bounded_and_does_not_end_by_waiting_less(place):
    told = [place.doubt(seen(10.2 + 0.1 * n, 0.3)) for n in range(11)]
    assert told[0] == "the pose jumped by 200 mm in 0.2 s: a second die? It is believed after 1 s"
    assert all(told[:10]) and told[10] == ""


def test_a_die_that_is_back_in_its_place_ends_the_doubt(place):
    assert place.doubt(seen(10.1, 0.3))
    place.claimed(seen(11.0, 0.1))
    assert place.doubt(seen(11.2, 0.3))  # which begins anew
    place.forget()
    assert place.doubt(seen(11.3, 0.3)) == ""


def show(driven, picture, count):
    """Pictures of one scene with fresh noise, 30 a second; where a pose was claimed (N, 3), camera frame."""
    driven.poses.clear()
    for _ in range(count):
        driven.number += 1
        t_ns = driven.now_ns + FRAME_NS - LATENCY_NS
        noise = np.random.default_rng(driven.number).integers(-2, 3, picture.colour.shape)
        colour = np.clip(picture.colour + noise, 0, 255).astype(np.uint8)
        times = {"colour_time_ns": t_ns, "depth_time_ns": t_ns, "frame_number": driven.number}
        driven.show(replace(picture, colour=colour, **times))
    claimed = [s.message.position for s in driven.poses if s.header.valid]
    T_camera_palm = rigid.inverse(T_PALM_CAMERA)
    return np.array(claimed).reshape(-1, 3) @ T_camera_palm[:3, :3].T + T_camera_palm[:3, 3]


def test_a_die_found_elsewhere_after_a_loss_is_not_claimed_for_a_while_and_then_believed():
    """The first is gone, one like it lies 90 mm beside: the CPU backend loses one and finds the other."""
    driven = DrivenPerception(CpuBackend(DIE), misfit=lambda _: "", elsewhere={"doubt_s": 0.5})
    first, second = photograph(FIRST), photograph(SECOND)
    assert np.allclose(show(driven, first, 6)[-1], FIRST[:3, 3], atol=0.001)
    assert not len(show(driven, second, 14)[3:])  # the first one's last pictures
    assert driven.poses and driven.said.state == "suspect"
    assert "the pose jumped by 90 mm in 0." in driven.said.message and "a second die?" in driven.said.message
    assert driven.fields["outliers"] > 0
    assert np.allclose(show(driven, second, 15)[-1], SECOND[:3, 3], atol=0.001)
    assert driven.said.state == "tracking"


def test_a_person_who_asks_for_a_new_search_has_what_is_found_believed_at_once():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    backend.pose = rigid.join((0.09, 0.0, 0.0), (1, 0, 0, 0)) @ HELD
    driven.see()
    assert driven.said.state == "suspect"
    driven.reset()
    for _ in range(3):
        driven.see()
    assert driven.said.state == "tracking" and driven.poses[-1].header.valid


def test_a_backend_that_jumps_to_a_second_die_is_not_believed():
    backend = ScriptedBackend()
    driven = DrivenPerception(backend).tracked()
    backend.pose = rigid.join((0.09, 0.0, 0.0), (1, 0, 0, 0)) @ HELD
    for _ in range(8):
        driven.see()
        assert driven.said.state == "suspect" and "jumped by 90 mm" in driven.said.message
    assert [sample.header.valid for sample in driven.poses] == [False] * 8
    assert driven.fields["outliers"] == 8
    backend.pose = HELD
    driven.see()
    assert driven.said.state == "tracking" and driven.poses[-1].header.valid

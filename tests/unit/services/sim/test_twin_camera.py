"""The emulated hand's camera: it sees the die where it is, at its rate, and has the faults it is told of."""

import json

import numpy as np
import pytest

from common.camera_config import CameraConfig
from common.camera_messages import CameraFrame, TwinTruth
from common.dexhand021.config import DexHandConfig
from common.task import get_task
from common.topics import CAMERA_FRAME, TWIN_TRUTH
from services.sim.camera_service import CameraFaults, CameraService
from services.sim.dexhand_physics import TwinPhysics
from services.sim.dexhand_twin import CUP_RAD
from services.sim.studio import Studio
from tests.samples import Driver, jobs, published

TASK = get_task("die")
TRUTH = TwinTruth(
    np.array(TASK.start_position, np.float32),
    np.array(TASK.start_rotation, np.float32),
    CUP_RAD.astype(np.float32),
)


@pytest.fixture(scope="module")
def drawn():
    config = CameraConfig()
    try:
        frame = Studio(config, DexHandConfig(), TwinPhysics(), 0).draw(TRUTH, 5, 3)
    except RuntimeError as error:  # no OpenGL on this machine
        pytest.skip(str(error))
    return config, frame


def seen_at(config, points):
    """Pixels (n, 2) and distances (n,) at which the camera should see points of the palm's frame."""
    T = np.linalg.inv(config.T_palm_camera)
    there = points @ T[:3, :3].T + T[:3, 3]
    pixels = there @ config.camera_matrix.T
    return pixels[:, :2] / pixels[:, 2:], there[:, 2]


def test_the_die_is_where_it_should_be_in_colour_and_depth(drawn):
    """The white face 1 looks out of the palm; its middle is a dark pip, and depth is that of its surface."""
    config, frame = drawn
    outward = np.array([1.0, 0.0, 0.0])
    middle = TRUTH.position.astype(float) + TASK.die.half_m * outward
    beside = middle + np.array([[0, 0.015, 0], [0, -0.015, 0], [0, 0, 0.015], [0, 0, -0.015]])
    (pip,), _ = seen_at(config, middle[None])
    corners, distances = seen_at(config, beside)
    levels = frame.colour.sum(axis=-1)
    u, v = np.rint(pip).astype(int)
    assert levels[v, u] < 200
    for (u, v), distance in zip(np.rint(corners).astype(int), distances, strict=True):
        assert levels[v, u] > 400
        assert frame.depth[v, u] * frame.depth_unit_m == pytest.approx(distance, abs=0.004)


def test_a_picture_tells_when_and_with_what_it_was_taken(drawn):
    config, frame = drawn
    assert (frame.colour_time_ns, frame.depth_time_ns, frame.frame_number) == (5, 5, 3)
    assert np.array_equal(frame.camera_matrix, config.camera_matrix)
    assert frame.colour.shape == (480, 640, 3) and 0.8 < np.mean(frame.depth > 0) < 1.0


def picture(truth, t_ns, number):
    colour = np.zeros((64, 64, 3), np.uint8)
    colour[..., 0] = number
    depth = np.full((64, 64), 400 + number, np.uint16)
    return CameraFrame(colour, depth, 0.001, np.eye(3), t_ns, t_ns, number)


@pytest.fixture
def camera():
    return Camera()


class Camera:
    """The service with a studio that draws at once."""

    def __init__(self):
        self.faults = CameraFaults()
        self.driver = Driver(CameraService(CameraConfig(rate_hz=10.0), picture, self.faults, 5))

    def show(self, ms):
        """A truth of that moment; the pictures that come of it."""
        self.driver.now_ns = ms * 1_000_000
        self.driver.send(TWIN_TRUTH, TRUTH, t_ns=self.driver.now_ns)
        out = self.driver.step()
        for job in jobs(out):
            self.driver.finish(job, job.function(*job.arguments))
        return published(out + self.driver.step(), CAMERA_FRAME)

    def tell(self, **fault):
        return self.faults.answer_query(json.dumps(fault).encode())


def test_truths_at_30_hz_give_pictures_at_10_hz(camera):
    pictures = [frame for ms in range(1000, 3000, 33) for frame in camera.show(ms)]
    assert 19 <= len(pictures) <= 21
    assert [frame.frame_number for frame in pictures] == list(range(1, len(pictures) + 1))
    gaps = np.diff([frame.colour_time_ns for frame in pictures]) / 1e6
    assert gaps.min() >= 66 and gaps.max() <= 132


def test_unplugged_it_sends_nothing_and_is_back_afterwards(camera):
    assert camera.show(1000)
    assert camera.tell(kind="unplugged", for_s=1.0) == b""
    assert not [frame for ms in range(1100, 2100, 100) for frame in camera.show(ms)]
    assert camera.show(2300)
    assert camera.driver.service.report().fields["withheld"] >= 9


def test_stuck_it_sends_the_same_picture_with_new_times(camera):
    (before,) = camera.show(1000)
    camera.tell(kind="stuck", for_s=1.0)
    (after,) = camera.show(1200)
    assert np.array_equal(after.colour, before.colour) and np.array_equal(after.depth, before.depth)
    assert after.colour_time_ns > before.colour_time_ns


def test_without_depth_and_with_swapped_channels(camera):
    camera.tell(kind="no_depth", for_s=1.0)
    camera.tell(kind="swapped", for_s=1.0)
    (frame,) = camera.show(1000)
    assert not frame.depth.any() and frame.colour[0, 0].tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    "payload", [b"", b"no json", b"{}", b'{"kind": "fire"}', b'{"kind": "stuck", "for_s": -1}']
)
def test_what_is_no_fault_is_answered_and_changes_nothing(camera, payload):
    assert camera.faults.answer_query(payload)
    assert camera.show(1000)

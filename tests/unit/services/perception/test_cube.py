"""The marker cube from exact pictures: accuracy, one face alone, hidden parts, foreign cubes, covariance."""

import cv2
import numpy as np
import pytest

from common import geometry
from common.camera_messages import PoseState
from common.die import DIE
from services.perception import rigid
from services.perception.backend import PoseEstimate, Unseen
from services.perception.config import CubeConfig
from services.perception.cube import CubeBackend
from tests.unit.services.perception.cubes import MARKERS, frame
from tests.unit.services.perception.flat import HEIGHT, WIDTH


def pose(seed, position=(0.01, -0.02, 0.42)):
    return rigid.join(position, geometry.normalise(np.random.default_rng(seed).normal(size=4)))


def facing(degrees, position=(0.0, 0.0, 0.42)):
    """One face straight at the camera, turned away from it by some degrees."""
    turn = geometry.from_axis_angle(np.array([1.0, 0.3, 0.0]), np.asarray(np.radians(180.0 + degrees)))
    return rigid.join(position, turn)


def offset(told, true):
    turn = cv2.Rodrigues(told[:3, :3].T @ true[:3, :3])[0]
    return 1e3 * np.linalg.norm(told[:3, 3] - true[:3, 3]), np.degrees(np.linalg.norm(turn))


def _corner_on():
    """The cube with a corner to the camera: three faces alike."""
    diagonal = np.array([1.0, 1.0, 1.0]) / np.sqrt(3)
    side = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    return np.stack([side, np.cross(side, diagonal), -diagonal]) @ np.eye(3)


@pytest.fixture
def backend():
    return CubeBackend(MARKERS, DIE)


@pytest.mark.parametrize("seed", range(6))
def test_the_cube_is_found_to_a_millimetre_and_a_degree_in_the_dies_own_frame(backend, seed):
    found = backend.register(frame(pose(seed), number=seed))
    assert isinstance(found, PoseEstimate)
    position_mm, rotation_deg = offset(found.T_camera_die, pose(seed))
    assert position_mm < 1.0 and rotation_deg < 1.0
    assert found.claimed and found.state is PoseState.TRACKING
    assert found.quality.consistent > 0.9 and found.label_posterior[0] == 1.0
    assert (found.t_ns, found.frame_number) == (seed * 33_000_000, seed)


@pytest.mark.parametrize("degrees", [-12, 12])
def test_a_single_face_may_tilt_two_ways_and_depth_says_which(backend, degrees):
    near = rigid.join((0, 0, 0.42), rigid.split(facing(degrees))[1])
    found = backend.register(frame(near))
    assert offset(found.T_camera_die, near)[1] < 4.0


def test_the_covariance_is_that_of_its_errors(backend):
    """Over many noisy pictures of one pose the normalised squared error is about 6, at most twice as much."""
    true = pose(2)
    squares = []
    for number in range(12):
        found = backend.register(frame(true, number=number, noise=6.0))
        turn = cv2.Rodrigues(found.T_camera_die[:3, :3] @ true[:3, :3].T)[0].ravel()
        error = np.concatenate([found.T_camera_die[:3, 3] - true[:3, 3], turn])
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.3 < np.mean(squares) < 12.0


def test_it_follows_only_what_was_found_and_again_after_hiding(backend):
    seen, nothing = frame(pose(1)), frame(None)
    assert backend.track(seen) == Unseen(PoseState.SEARCHING, "no marker cube yet", 0, 0)
    assert backend.register(nothing).message == "no marker of the cube in view"
    backend.adopt(backend.register(seen))
    assert backend.track(seen).claimed
    assert backend.track(nothing) == Unseen(PoseState.LOST, "no marker of the cube in view", 0, 0)
    assert backend.track(seen).claimed
    backend.reset()
    assert backend.track(seen).state is PoseState.SEARCHING


def test_a_mask_shuts_a_second_cube_out(backend):
    left, right = pose(1, (-0.1, 0, 0.42)), pose(1, (0.1, 0, 0.42))
    mask = np.zeros((HEIGHT, WIDTH), np.bool_)
    mask[:, WIDTH // 2 :] = True
    found = backend.register(frame(right), mask)
    assert offset(found.T_camera_die, right)[0] < 1.0
    assert isinstance(backend.register(frame(left), mask), Unseen)


def test_depth_that_contradicts_takes_the_claim_away(backend):
    seen = frame(pose(1))
    seen.depth[:] += 30
    found = backend.register(seen)
    assert not found.claimed and found.state is PoseState.SUSPECT
    assert found.quality.violated > 0.9 and found.quality.consistent < 0.1


def test_another_cube_fits_no_pose(backend):
    """Three faces in another order: markers that cannot be where they are seen."""
    corner_on = rigid.join((0, 0, 0.42), rigid.from_matrix(_corner_on()))
    assert CubeBackend(MARKERS, DIE).register(frame(corner_on)).quality.consistent > 0.9
    found = CubeBackend(CubeConfig(first=0), DIE).register(frame(corner_on))
    assert isinstance(found, Unseen) and "is it the one configured?" in found.message


def test_markers_larger_than_the_cube_are_refused():
    with pytest.raises(ValueError, match="does not fit on a face"):
        CubeBackend(CubeConfig(marker_m=0.07), DIE)

"""The picture lies where the camera matrix says, and depth is along the optical axis."""

import mujoco
import numpy as np
import pytest

from services.sim.camera import Optics, SceneCamera

OPTICS = Optics(width=160, height=120, focal_px=150.0, centre_px=(70.3, 66.8))
SPHERE = """<mujoco><worldbody><light pos="0 0 3"/>
  <geom type="sphere" size="0.02" pos="0.05 -0.03 0.1" rgba="1 0 0 1"/>
  <geom type="plane" size="5 5 .1" rgba="0 0 1 1"/></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def scene():
    model = mujoco.MjModel.from_xml_string(SPHERE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = SceneCamera(model, OPTICS)
    camera.update(data)
    yield camera
    camera.close()
    camera.close()


def looking_down(height_m, x=0.0, y=0.0):
    """The camera's x is the world's x, its y is the world's -y."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x, y, height_m
    return pose


def test_a_ball_appears_where_k_projects_it(scene):
    pose = looking_down(0.6)
    view = scene.view(pose)
    red = (view.colour[..., 0] > 2 * view.colour[..., 2].astype(int)) & (view.colour[..., 0] > 20)
    rows, columns = np.nonzero(red)
    u, v, w = OPTICS.camera_matrix @ (np.linalg.inv(pose) @ [0.05, -0.03, 0.1, 1.0])[:3]
    assert (columns.mean(), rows.mean()) == pytest.approx((u / w, v / w), abs=0.5)


def test_depth_is_along_the_axis_to_a_tenth_of_a_millimetre(scene):
    view = scene.view(looking_down(0.6, x=2.0))  # only the table is in view
    assert np.allclose(view.depth_m, 0.6, atol=1e-4)
    assert np.allclose(scene.depth(looking_down(0.6, x=2.0)), 0.6, atol=1e-4)
    assert scene.depth(looking_down(0.6)).min() == pytest.approx(0.48, abs=5e-4)


def test_where_nothing_is_there_is_no_depth(scene):
    upwards = np.eye(4)
    upwards[:3, 3] = 0, 0, 1
    assert not scene.view(upwards).depth_m.any()


def test_a_shift_moves_the_picture_by_that_much(scene):
    pose = looking_down(0.6)
    moved, still = scene.view(pose, (3.0, -2.0)).colour[:-2, 3:], scene.view(pose).colour[2:, :-3]
    different = np.abs(moved.astype(int) - still).max(axis=-1) > 2
    assert different.mean() < 0.001  # rounding at the ball's edge
    assert (still[..., 0] > 20).any()

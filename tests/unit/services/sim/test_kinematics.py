"""The scene drawn from a state is the scene that the simulator was in."""

import mujoco
import numpy as np
import pytest

from common.task import TASKS
from services.sim.kinematics import SceneKinematics
from services.sim.plants import make_plant


@pytest.mark.parametrize("task_name", TASKS)
def test_bodies_are_where_the_simulator_has_them(task_name):
    plant = make_plant(task_name)
    plant.reset(3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        state = plant.step(rng.uniform(-1, 1, plant.task.action_dim))
    # MuJoCo leaves the bodies where they were one substep before the joints that it reports.
    mujoco.mj_kinematics(plant.model, plant.data)
    names, positions, quaternions = plant.bodies()

    drawn = SceneKinematics(task_name).bodies(state.astype(np.float32), plant.goal)

    assert drawn[0] == names
    # The DexHand's joints without a motor give way a little; a state does not tell.
    tolerance = 1e-3 if task_name.startswith("die") else 1e-5
    np.testing.assert_allclose(drawn[1], positions, atol=tolerance)
    alike = np.abs(np.sum(drawn[2] * quaternions, axis=1))
    np.testing.assert_allclose(alike, 1.0, atol=tolerance)


def test_every_mesh_has_a_place():
    kinematics = SceneKinematics("block")
    state = np.zeros(kinematics.task.state_dim)
    names = kinematics.bodies(state, np.zeros(7))[0]
    assert {body.name for body in kinematics.scene().bodies} <= set(names)
    assert {"object", "goal", "palm"} <= {body.name for body in kinematics.scene().bodies}


def test_the_dexhand_shows_its_die_with_pips_and_its_goal():
    kinematics = SceneKinematics("die")
    scene = {body.name: body.meshes for body in kinematics.scene().bodies}
    names = kinematics.bodies(np.zeros(24), kinematics.task.goal(2))[0]
    assert set(scene) <= set(names)
    assert {"palm", "1_4", "die", "goal"} <= set(scene)
    body, pips = scene["die"]
    assert body.rgba.mean() > 0.9
    assert pips.rgba[:3].mean() < 0.2
    assert kinematics.scene().nbytes < 500_000


def test_a_goal_of_another_task_is_refused():
    kinematics = SceneKinematics("reach")
    with pytest.raises(ValueError, match="15"):
        kinematics.bodies(np.zeros(63), np.zeros(7))

"""The scene drawn from a state is the scene that the simulator was in."""

import mujoco
import numpy as np
import pytest

from common.task import TASKS
from services.sim.kinematics import SceneKinematics
from services.sim.plant import ShadowHandPlant


@pytest.mark.parametrize("task_name", TASKS)
def test_bodies_are_where_the_simulator_has_them(task_name):
    plant = ShadowHandPlant(task_name, seed=3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        state = plant.step(rng.uniform(-1, 1, plant.task.action_dim))
    # MuJoCo leaves the bodies where they were one substep before the joints that it reports.
    mujoco.mj_kinematics(plant.model, plant.data)
    names, positions, quaternions = plant.bodies()

    drawn = SceneKinematics(task_name).bodies(state.astype(np.float32), plant.goal)

    assert drawn[0] == names
    np.testing.assert_allclose(drawn[1], positions, atol=1e-5)
    alike = np.abs(np.sum(drawn[2] * quaternions, axis=1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-5)


def test_every_mesh_has_a_place():
    kinematics = SceneKinematics("block")
    state = np.zeros(kinematics.task.state_dim)
    names = kinematics.bodies(state, np.zeros(7))[0]
    assert {body.name for body in kinematics.scene().bodies} <= set(names)
    assert {"object", "goal", "palm"} <= {body.name for body in kinematics.scene().bodies}


def test_a_goal_of_another_task_is_refused():
    kinematics = SceneKinematics("reach")
    with pytest.raises(ValueError, match="15"):
        kinematics.bodies(np.zeros(63), np.zeros(7))

"""The model has the documented figures; numbers here are copied from the makers' files by hand, in mm."""

import mujoco
import numpy as np
import pytest

from common import geometry
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import JOINTS, Hand
from common.task import get_task
from services.sim import dexhand_links as links
from services.sim.dexhand_model import build_model, mount_of
from services.sim.dexhand_physics import TwinPhysics

TOLERANCE_MM = 0.1
TIPS = {
    "1_4": (59.6, 131.1, 125.2),
    "2_4": (3, 34.9, 284.4),
    "3_4": (3, 10.6, 293.4),
    "4_4": (3, -13.7, 284.4),
    "5_4": (3, -38.0, 270.4),
}
MCP_HEIGHTS = {"2_2": 181.4, "3_2": 190.4, "4_2": 181.4, "5_2": 167.4}
AXES = {"1_1": (-0.22, 0.208, -0.953), "1_2": (0.943, -0.203, -0.262)}
AXES |= dict.fromkeys(MCP_HEIGHTS, (0.0, 1.0, 0.0))


class Hands:
    """A model and what it looks like in the palm's frame."""

    def __init__(self, hand):
        self.task = get_task("die") if hand is Hand.RIGHT else get_task("die").mirrored()
        self.model = build_model(self.task, DexHandConfig(hand=hand), TwinPhysics())
        self.data = mujoco.MjData(self.model)
        self.side = 1.0 if hand is Hand.RIGHT else -1.0
        self.pose({})

    def pose(self, angles):
        self.data.qpos[:] = self.model.qpos0
        for name, angle in angles.items():
            self.data.qpos[self.model.joint(name).qposadr[0]] = angle
        mujoco.mj_forward(self.model, self.data)

    def to_palm(self, vectors):
        rotation = self.data.xmat[self.model.body("palm").id].reshape(3, 3)
        return np.asarray(vectors) @ rotation * (1.0, self.side, 1.0)

    def point(self, body, at):
        index = self.model.body(body).id
        place = self.data.xpos[index] + self.data.xmat[index].reshape(3, 3) @ (
            at * np.array([1, self.side, 1])
        )
        return 1e3 * self.to_palm(place - self.data.xpos[self.model.body("palm").id])


@pytest.fixture(scope="module", params=list(Hand))
def hands(request):
    return Hands(request.param)


def test_zero_pose_is_where_the_makers_have_it(hands):
    hands.pose({})
    for body, tip in TIPS.items():
        assert np.allclose(hands.point(body, links.TIP), tip, atol=TOLERANCE_MM), body
    for body, height in MCP_HEIGHTS.items():
        assert hands.point(body, (0, 0, 0))[2] == pytest.approx(height, abs=TOLERANCE_MM)


def test_axes_at_zero_are_the_makers(hands):
    hands.pose({})
    for name, axis in AXES.items():
        seen = hands.to_palm(hands.data.xaxis[hands.model.joint(name).id])
        # A mirrored rotation is one the other way about the mirrored axis.
        assert np.allclose(seen * hands.side, axis, atol=2e-3), name


def test_the_opposed_thumb_is_where_the_makers_have_it(hands):
    hands.pose({"1_1": 1.57})
    assert np.allclose(hands.point("1_4", links.TIP), (136.9, 2.1, 79.1), atol=TOLERANCE_MM)


def test_positive_angles_flex_oppose_and_spread_outward(hands):
    hands.pose({})
    rest = {finger: hands.point(f"{finger}_4", links.TIP) for finger in range(1, 6)}
    hands.pose({f"{finger}_2": 0.5 for finger in range(2, 6)})
    assert all(hands.point(f"{f}_4", links.TIP)[0] > rest[f][0] + 20 for f in range(2, 6))
    hands.pose({"2_1": 0.2, "4_1": 0.2, "5_1": 0.4})
    assert hands.point("2_4", links.TIP)[1] > rest[2][1] + 10
    assert hands.point("5_4", links.TIP)[1] < hands.point("4_4", links.TIP)[1] - 10 < rest[4][1] - 20


def test_masses_are_the_makers(hands):
    model = hands.model
    mass = {name: model.body(name).mass[0] for name in ("palm", "1_1", "1_2", "2_1", "3_2", "4_3", "5_4")}
    documented = [0.8835, 0.0044, 0.0100, 0.0041, 0.0094, 0.0046, 0.0062 + 0.002]
    assert list(mass.values()) == pytest.approx(documented)
    assert model.body_mass.sum() - model.body("die").mass[0] == pytest.approx(1.016, abs=5e-4)
    assert np.allclose(model.body("die").inertia, 0.1 * 0.06**2 / 6)


def test_ranges_and_motors_are_those_of_the_tables(hands):
    model = hands.model
    assert [model.actuator(i).name for i in range(model.nu)] == [joint.name for joint in JOINTS]
    for name, joint in zip(links.MOTOR_JOINTS, JOINTS, strict=True):
        assert model.joint(name).range.tolist() == [0.0, joint.model_high_rad]
        assert model.joint(model.actuator(joint.name).trnid[0]).name == name
    assert model.joint("5_1").range[1] == pytest.approx(0.6)
    assert model.joint("4_1").range[1] == pytest.approx(0.3)
    assert model.njnt == 12 + 7 + 1  # motors, followers, the free die: 3_1 is welded


def test_followers_keep_their_ratio_under_motion():
    assumed = DexHandConfig(distal_ratio=0.8, spread_ratios=(1.0, 0.5, 1.5))
    model = build_model(get_task("die"), assumed, TwinPhysics())
    data = mujoco.MjData(model)
    data.qpos[model.joint("die").qposadr[0] + 1] = 0.4  # out of the way
    data.ctrl[:] = 0.5 * np.array([joint.model_high_rad for joint in JOINTS])
    mujoco.mj_step(model, data, 500)
    angle = {model.joint(i).name: data.qpos[model.joint(i).qposadr[0]] for i in range(19)}
    assert angle["2_1"] == pytest.approx(0.15, abs=0.01)
    assert angle["4_1"] == pytest.approx(0.5 * angle["2_1"], abs=2e-3)
    assert angle["5_1"] == pytest.approx(1.5 * angle["2_1"], abs=2e-3)
    for finger in range(1, 6):
        assert angle[f"{finger}_4"] == pytest.approx(0.8 * angle[f"{finger}_3"], abs=2e-3)


def test_nothing_of_the_hand_overlaps_at_zero_nor_in_any_single_flexion(hands):
    for name, joint in [(None, None), *zip(links.MOTOR_JOINTS, JOINTS, strict=True)]:
        hands.pose({} if name is None else {name: 0.5 * joint.model_high_rad, "die": 0.0})
        touching = [contact for contact in hands.data.contact if _of_the_hand(hands.model, contact)]
        assert not touching, name


def _of_the_hand(model, contact):
    bodies = {model.body(model.geom_bodyid[geom]).name for geom in (contact.geom1, contact.geom2)}
    return not bodies & {"die", "world"}


@pytest.mark.parametrize("up", [(1.0, 0.0, 0.0), (0.9, -0.3, 0.3), get_task("die").up])
def test_the_mount_turns_the_tasks_up_to_the_worlds(up):
    task = get_task("die").__class__("die", get_task("die").groups, goal_dim=7, up=up)
    mount = mount_of(task)
    seen = geometry.rotate(mount, np.array(up) / np.linalg.norm(up))
    assert np.allclose(seen, (0, 0, 1), atol=1e-9)
    fingers = geometry.rotate(mount, np.array([0.0, 0.0, 1.0]))
    assert fingers[0] > 0.9
    assert abs(fingers[1]) < 1e-9

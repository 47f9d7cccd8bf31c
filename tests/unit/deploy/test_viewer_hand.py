"""What the dashboard shows of a DexHand, driven over a bus or simulated."""

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from common.cell import SharedConfig
from common.config import parse
from common.dexhand021.tables import HIGH_RAD, JOINTS, Hand
from common.task import get_task
from deploy.cell import load_cell, process_config
from deploy.viewer.blueprint import dashboard
from deploy.viewer.build import ViewerProcess
from deploy.viewer.config import ViewerConfig
from deploy.viewer.curves import curves_of
from deploy.viewer.dashboard import Dashboard
from deploy.viewer.drawer import Drawer
from deploy.viewer.drawing import Arrow, Event, Scalars, State
from deploy.viewer.hand_curves import BEHIND_M, LONGEST_M, TIPS, force_arrow, force_path, hand_curves
from services.sim.dexhand_twin import DexHandTwin
from services.sim.kinematics import SceneKinematics
from tests.unit.deploy.viewer_samples import PERIOD_NS, joints, step

BOARDS = ("thumb", "palm", "index", "middle", "ring", "little")


@pytest.fixture(scope="module")
def kinematics():
    return SceneKinematics("die")


@pytest.fixture
def drawer(kinematics):
    return Drawer(kinematics, PERIOD_NS, ghost=False)


def shown(drawings, prefix="hand/"):
    return {
        d.path: d.value.values.tolist()
        for d in drawings
        if d.path.startswith(prefix) and isinstance(d.value, Scalars)
    }


def arrows(drawings):
    return {d.path: np.linalg.norm(d.value.vector) for d in drawings if isinstance(d.value, Arrow)}


def texts(drawings):
    return [(d.value.level, d.value.text) for d in drawings if isinstance(d.value, Event)]


def test_a_driven_hand_shows_motors_boards_and_fingertips(drawer):
    drawn = drawer.draw(joints())
    values = shown(drawn)
    for i, joint in enumerate(JOINTS):
        assert values[f"hand/angle_rad/{joint.name}"] == pytest.approx([i / 10, i / 10 + 0.5])
    for i, board in enumerate(BOARDS):
        assert values[f"hand/current_ma/{board}"] == [2 * i, 2 * i + 1]
        assert values[f"hand/temperature_c/{board}"] == [30 + i]
        assert (values[f"hand/age_ms/{board}"], values[f"hand/rate_hz/{board}"]) == ([i], [50 + i])
    tips = [board for board in BOARDS if board != "palm"]
    assert [values[f"hand/force_n/{tip}"] for tip in tips] == [[i] for i in range(5)]
    lengths = arrows(drawn)
    assert [lengths[f"world/force/{tip}"] / lengths["world/force/index"] for tip in tips] == pytest.approx(
        [0, 1, 2, 3, 4]
    )
    assert texts(drawn) == [("INFO", "hand_io: running")]
    assert [d.value for d in drawn if d.path == "state/hand"] == [State("running")]


def test_what_is_not_valid_is_not_drawn(drawer):
    drawn = drawer.draw(
        joints(
            force_valid=np.array([1, 0, 1, 1, 1], np.uint8),
            temperature_valid=np.array([1, 0, 1, 1, 1, 1], np.uint8),
        )
    )
    values = shown(drawn)
    assert "hand/force_n/index" not in values and "hand/force_n/middle" in values
    assert "hand/temperature_c/palm" not in values and "hand/temperature_c/index" in values
    assert arrows(drawn)["world/force/index"] == 0.0  # an old arrow must not stay


def test_the_log_and_the_lane_tell_changes_only(drawer):
    drawer.draw(joints())
    assert texts(drawer.draw(joints())) == []
    hurt = drawer.draw(joints(faults=("ff_dip: STALL",)))
    assert texts(hurt) == [("WARN", "hand_io: running: ff_dip: STALL")]
    assert [d for d in hurt if d.path == "state/hand"] == []
    held = drawer.draw(joints(state="fault", faults=("bus off",)))
    assert texts(held) == [("WARN", "hand_io: fault: bus off")]
    assert [d.value for d in held if d.path == "state/hand"] == [State("fault")]
    assert texts(drawer.draw(joints(state="hold"))) == [("INFO", "hand_io: hold")]


def test_a_simulated_hand_shows_what_its_steps_tell(drawer):
    state = step("die", 0).message.state.copy()
    state[:12], state[12:17] = HIGH_RAD / 2, [0, 1, 2, 3, 4]
    first = shown(drawer.draw(step("die", 0, state=state)))
    assert first["hand/angle_rad/th_rot"] == pytest.approx([HIGH_RAD[2] / 2] * 2)  # nothing was asked for yet
    ends = np.array([-1, 1, *[0] * 10], np.float32)
    drawn = drawer.draw(step("die", 1, state=state, prev_action=ends))
    values = shown(drawn)
    assert values["hand/angle_rad/th_dip"] == pytest.approx([HIGH_RAD[0] / 2, 0.0])
    assert values["hand/angle_rad/th_mcp"] == pytest.approx([HIGH_RAD[1] / 2, HIGH_RAD[1]])
    assert [values[f"hand/force_n/{tip}"] for tip in TIPS] == [[0], [1], [2], [3], [4]]
    assert shown(drawer.draw(step("die", 1, state=state))) == {}  # seen before


def test_steps_are_silent_about_a_hand_that_speaks_for_itself(drawer):
    assert shown(drawer.draw(step("die", 0)))
    drawer.draw(joints())
    drawn = drawer.draw(step("die", 1))
    assert (shown(drawn), arrows(drawn)) == ({}, {})
    assert any(d.path == "world/hand" for d in drawn)


def test_an_episode_tells_the_face_that_is_wanted(drawer):
    goal = get_task("die").goal(5).astype(np.float32)
    assert ("INFO", "plant: episode 0 begins: plan, face 5 up") in texts(
        drawer.draw(step("die", 0, goal=goal))
    )


@pytest.mark.parametrize("hand", Hand)
def test_a_force_is_drawn_behind_the_pad_along_its_normal(hand):
    model = DexHandTwin(hand).model
    for finger in range(1, 6):
        parts = [
            model.geom(i)
            for i in range(model.ngeom)
            if model.geom(i).bodyid[0] == model.body(f"{finger}_4").id
        ]
        pad = next(part for part in parts if part.type[0] == mujoco.mjtGeom.mjGEOM_ELLIPSOID)
        bone = next(part for part in parts if part.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE)
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, pad.quat)
        thin = axes.reshape(3, 3)[:, pad.size.argmin()]
        inwards = thin * np.sign(thin @ (bone.pos - pad.pos))
        origin, vector = force_arrow(2.0, hand)
        assert vector / np.linalg.norm(vector) == pytest.approx(inwards, abs=1e-6)
        assert origin[:2] == pytest.approx((pad.pos + BEHIND_M * inwards)[:2], abs=1e-6)
        along = np.zeros(9)
        mujoco.mju_quat2Mat(along, bone.quat)
        assert np.linalg.norm(np.cross(origin - bone.pos, along.reshape(3, 3)[:, 2])) > bone.size[0]


def test_an_arrow_grows_with_the_force_up_to_an_end():
    lengths = [np.linalg.norm(force_arrow(force_n, Hand.RIGHT)[1]) for force_n in (-1, 0, 1, 2, 1e6)]
    assert lengths[:2] == [0, 0]
    assert lengths[3] == pytest.approx(2 * lengths[2])
    assert lengths[4] == pytest.approx(LONGEST_M)


def test_legends_fit_the_curves(drawer):
    drawn = {path: len(values) for path, values in shown(drawer.draw(joints())).items()}
    curves = hand_curves()
    assert drawn == {item.path: len(item.names) for item in curves}
    assert all(len(item.colours) == len(item.names) for item in curves)


def views(part):
    for child in getattr(part, "contents", ()):
        if isinstance(child, str):
            yield child
        else:
            yield from views(child)


@pytest.mark.parametrize("driven", [True, False])
def test_every_plot_of_the_hand_has_something_to_show(driven):
    root = dashboard(get_task("die"), driven).root_container
    wanted = {text.removeprefix("+ /") for text in views(root) if text.startswith("+ /hand")}
    drawn = [item.path for item in hand_curves()]
    assert all(any(path.startswith(want.removesuffix("**")) for path in drawn) for want in wanted)
    missing = [path for path in drawn if not any(path.startswith(want.removesuffix("**")) for want in wanted)]
    only_driven = ("hand/current_ma/", "hand/temperature_c/", "hand/age_ms/", "hand/rate_hz/")
    assert all(path.startswith(only_driven) for path in missing)
    assert bool(missing) is not driven


def test_other_tasks_have_no_hand_page():
    assert not [text for text in views(dashboard(get_task("reach"), False).root_container) if "/hand" in text]
    assert not {item.path for item in curves_of(get_task("die"))} & {item.path for item in hand_curves()}


def test_it_can_be_read_back(tmp_path):
    shared = SharedConfig(task="die", run_dir=tmp_path)
    board = Dashboard(shared, ViewerConfig(serve=False), driven=True)
    board.open()
    board.draw([step("die", 0), joints(0), joints(1, 10**8, force_n=np.full(5, 3.0, np.float32))])
    board.close()
    rows, frames = [], []
    for part in RrdReader(tmp_path / "recording-0.rrd").stream().filter(content=f"/{force_path('ring')}"):
        batch = part.to_record_batch()
        for name in batch.schema.names:
            if name.endswith(":vectors") and not part.is_static:
                rows += [np.linalg.norm(row[0]) for row in batch[name].to_pylist()]
            if name.endswith(":frame"):
                frames += batch[name].to_pylist()
    expected = [np.linalg.norm(force_arrow(force_n, Hand.RIGHT)[1]) for force_n in (0.0, 3.0, 3.0)]
    assert sorted(rows) == pytest.approx(sorted(expected), abs=1e-6)
    assert frames == [["4_4"]]


def test_the_viewer_is_told_which_plant_it_looks_at():
    for cell, plant in (("die", "sim"), ("dexhand_twin", "twin")):
        told = parse(ViewerProcess, process_config(load_cell(cell), "viewer"), cell)
        assert told.plant == plant

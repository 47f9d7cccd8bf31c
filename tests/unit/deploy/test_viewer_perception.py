"""What the dashboard shows of camera and perception."""

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from common import geometry
from common.camera_messages import CameraPreview, PoseState, PoseTracking, TwinTruth
from common.cell import SharedConfig
from common.hand_messages import ObjectPose, PoseSource
from common.messages import Header, Sample
from common.task import get_task
from deploy.viewer.blueprint import dashboard
from deploy.viewer.config import ViewerConfig
from deploy.viewer.dashboard import Dashboard
from deploy.viewer.drawing import Bars, Event, Picture, Scalars, State, When
from deploy.viewer.perception import LANE, PerceptionDrawer, perception_curves
from services.perception.overlay import jpeg
from tests.unit.deploy.test_viewer_hand import views

WHEN = When(3, 10**18, 1)
TURN = geometry.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.asarray(np.radians(2.0))).astype(np.float32)


def pose(position=(0.1, 0.0, 0.2), rotation=TURN):
    return ObjectPose(
        np.array(position, np.float32),
        np.array(rotation, np.float32),
        np.eye(6, dtype=np.float32),
        0.9,
        np.eye(24, dtype=np.float32)[0],
        PoseSource.PERCEPTION,
    )


def truth(position=(0.1, 0.0, 0.2)):
    return TwinTruth(
        np.array(position, np.float32), np.array([1, 0, 0, 0], np.float32), np.zeros(12, np.float32)
    )


def tracking(state=PoseState.TRACKING, message="", number=5):
    quality = np.array([0.8, 0.1, 0.05, 0.7], np.float32)
    labels = np.eye(24, dtype=np.float32)[0] if number else np.zeros(24, np.float32)
    return PoseTracking(state, message, True, quality, labels, number, 42.0, 6.0)


def drawn(drawer, message, t_ns=7, valid=True):
    sample = Sample("key", Header(1, 1, t_ns, valid), message)
    return {drawing.path: drawing.value for drawing in drawer.draw(sample, WHEN)}


@pytest.mark.parametrize("first", ["pose", "truth"])
def test_a_pose_is_compared_with_the_truth_of_its_own_moment(first):
    drawer = PerceptionDrawer()
    drawn(drawer, truth((9, 9, 9)), t_ns=6)
    told, true = (pose((0.103, 0.004, 0.2)), 7), (truth(), 7)
    order = [told, true] if first == "pose" else [true, told]
    shown = [drawn(drawer, message, t_ns) for message, t_ns in order][-1]
    assert shown["perception/error_mm/claimed"].values == pytest.approx([5.0], abs=1e-3)
    assert shown["perception/error_deg/claimed"].values == pytest.approx([2.0], abs=1e-3)


def test_an_unclaimed_pose_is_compared_apart():
    drawer = PerceptionDrawer()
    drawn(drawer, truth())
    shown = drawn(drawer, pose(), valid=False)
    assert {path for path in shown if "error" in path} == {
        "perception/error_mm/unclaimed",
        "perception/error_deg/unclaimed",
    }


def test_truths_without_a_pose_do_not_pile_up():
    drawer = PerceptionDrawer()
    for t_ns in range(1000):
        drawn(drawer, truth(), t_ns)
        drawn(drawer, pose(), t_ns + 10**6)
    assert len(drawer._truths) == len(drawer._poses) == 64


def test_pictures_quality_labels_and_times():
    drawer = PerceptionDrawer()
    picture = jpeg(np.full((8, 8, 3), 200, np.uint8))
    shown = drawn(drawer, CameraPreview(picture, jpeg(np.zeros((8, 8), np.uint8))))
    assert shown["perception/colour"] == Picture(picture)
    assert cv2.imdecode(np.frombuffer(shown["perception/depth"].data, np.uint8), 0).shape == (8, 8)
    shown = drawn(drawer, tracking())
    assert shown["perception/quality"].values == pytest.approx([0.8, 0.1, 0.05, 0.7])
    assert shown["perception/latency_ms"].values.tolist() == [42.0, 6.0]
    assert isinstance(shown["perception/labels"], Bars) and shown["perception/labels"].values[0] == 1.0


def test_states_are_told_when_they_change_and_messages_when_more_than_numbers_do():
    drawer = PerceptionDrawer()
    told = [
        drawn(drawer, tracking()),
        drawn(drawer, tracking()),
        drawn(drawer, tracking(PoseState.SUSPECT, "no picture for 0.3 s", number=0)),
        drawn(drawer, tracking(PoseState.SUSPECT, "no picture for 0.8 s", number=0)),
        drawn(drawer, tracking(PoseState.LOST, "no picture for 1.0 s", number=0)),
    ]
    assert [shown.get(LANE) for shown in told] == [
        State("tracking"),
        None,
        State("suspect"),
        None,
        State("lost"),
    ]
    assert told[2]["log/perception"] == Event("perception: suspect: no picture for 0.3 s", "WARN")
    assert "perception/quality" not in told[2] and "perception/latency_ms" not in told[2]


def test_every_curve_has_as_many_names_as_values():
    drawer = PerceptionDrawer()
    drawn(drawer, truth())
    shown = drawn(drawer, tracking()) | drawn(drawer, pose()) | drawn(drawer, truth(), 8)
    curves = {curves.path: curves for curves in perception_curves()}
    for path, value in shown.items():
        if isinstance(value, Scalars):
            assert len(curves[path].names) == len(value.values)


def test_only_a_watched_hand_has_the_page():
    die = get_task("die")
    with_page = [text for text in views(dashboard(die, True, True).root_container) if "perception/" in text]
    assert len(with_page) == 5
    assert not [text for text in views(dashboard(die, True).root_container) if "perception/" in text]


def test_pictures_and_bars_can_be_read_back(tmp_path):
    shared = SharedConfig(task="die", run_dir=tmp_path)
    board = Dashboard(shared, ViewerConfig(serve=False), driven=True, watched=True)
    board.open()
    picture = jpeg(np.full((8, 8, 3), 200, np.uint8))
    messages = [tracking(), CameraPreview(picture, picture), tracking()]
    board.draw([Sample("key", Header(1, 1, 10**18 + n, True), m) for n, m in enumerate(messages)])
    board.close()
    rows = {"colour": 0, "labels": 0}
    for name in rows:
        for part in RrdReader(tmp_path / "recording-0.rrd").stream().filter(content=f"/perception/{name}"):
            rows[name] += 0 if part.is_static else part.to_record_batch().num_rows
    assert rows == {"colour": 1, "labels": 2}

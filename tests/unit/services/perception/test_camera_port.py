"""A camera as a port: recordings at their own pace and with today's times, cameras that come and go."""

import threading

import numpy as np
import pytest

from common.camera_config import CameraConfig
from common.config import ConfigError
from common.hand_messages import ArmReply
from services.perception import camera_port
from services.perception.build import build, place_of
from services.perception.calibration import Calibration, Pose, Residuals
from services.perception.camera_port import CameraPort
from services.perception.config import PerceptionConfig, PerceptionProcess, SourceConfig
from services.perception.frames import Refusal, Refused
from services.perception.recording import Recorder
from services.perception.sources import open_source, source_at
from tests.unit.services.perception.cubes import frame
from tests.unit.services.perception.driven import HELD, DrivenPerception

NOTHING = Refused(Refusal.TIMEOUT, "nothing came")
OVER = Refused(Refusal.ENDED, "over")


class Scripted:
    """Gives what it is told to, then says that it is over."""

    def __init__(self, *reads):
        self.reads, self.closed = list(reads), False

    def read(self, timeout_s):
        return self.reads.pop(0) if self.reads else OVER

    def close(self):
        self.closed = True


class Cameras:
    """One after another, each time that one is opened; then none."""

    def __init__(self, *cameras):
        self.cameras, self.opened = list(cameras), []

    def __call__(self):
        if not self.cameras:
            raise RuntimeError("no device connected")
        self.opened.append(self.cameras.pop(0))
        return self.opened[-1]


class Pacing:
    """A clock, and an event whose waits move it on."""

    def __init__(self):
        self.ns, self.set = 10**18, False

    def now_ns(self):
        return self.ns

    def wait(self, seconds):
        self.ns += round(seconds * 1e9)
        return self.set

    def is_set(self):
        return self.set


class FixedClock:
    def now_ns(self):
        return 10**18


def delivered(cameras, count, replayed=False):
    """The first pictures that come, and the port."""
    got, enough = [], threading.Event()
    port = CameraPort(cameras, replayed, clock=FixedClock())

    def take(topic, message):
        assert topic.key == "camera/frame"
        got.append(message)
        if len(got) >= count:
            enough.set()

    port.open(take)
    assert enough.wait(10)
    port.close()
    return got[:count], port


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    monkeypatch.setattr(camera_port, "REOPEN_S", 0.001)


def test_frames_pass_with_their_own_times():
    got, port = delivered(Cameras(Scripted(frame(HELD, 1), NOTHING, frame(HELD, 2))), 2)
    assert [message.frame_number for message in got] == [1, 2]
    assert [message.colour_time_ns for message in got] == [33_000_000, 66_000_000]
    assert port.counts["timeout"] == 1 and port.counts["frames"] == 2


def test_a_recording_is_shown_now_with_its_frames_as_far_apart_as_they_were():
    got, _ = delivered(Cameras(Scripted(frame(HELD, 1), frame(HELD, 2), frame(HELD, 3))), 3, replayed=True)
    assert [message.depth_time_ns - 10**18 for message in got] == [0, 33_000_000, 66_000_000]


def player(folder, repeat):
    recorder = Recorder(folder)
    for number in (1, 2, 3):
        recorder.write(frame(HELD, number))
    recorder.close()
    return lambda: open_source(SourceConfig(kind="recording", path=folder, repeat=repeat))


def read_out(open_recording, count):
    """The times, ms since the start, of `count` pictures at most of a recording that is shown now."""
    pacing, got = Pacing(), []

    def take(topic, message):
        got.append((message.depth_time_ns - 10**18) / 1e6)
        pacing.set = len(got) >= count

    port = CameraPort(open_recording, replayed=True, clock=pacing)
    port._stop, port._deliver = pacing, take
    port._run()
    return got, port


def test_a_recording_that_is_repeated_goes_on_in_time(tmp_path):
    got, _ = read_out(player(tmp_path, repeat=True), 7)
    assert np.diff(got) == pytest.approx([33, 33, 33.333333] * 2, abs=1e-5)


def test_a_recording_that_is_not_repeated_is_shown_once(tmp_path):
    got, port = read_out(player(tmp_path, repeat=False), 7)
    assert got == [0, 33, 66] and "no more frames" in port.last_error


class Raising(Scripted):
    def read(self, timeout_s):
        if not self.reads:
            raise KeyError("serial")
        return super().read(timeout_s)

    def close(self):
        raise AttributeError("half open")


def test_whatever_a_driver_raises_it_is_noted_and_the_camera_opened_again():
    cameras = iter([TypeError("no such option"), Raising(frame(HELD, 1)), Scripted(frame(HELD, 2))])

    def opened():
        camera = next(cameras, RuntimeError("no device connected"))
        if isinstance(camera, Exception):
            raise camera
        return camera

    got, port = delivered(opened, 2)
    assert [message.frame_number for message in got] == [1, 2]
    assert port.counts["unopened"] >= 1 and port.counts["failed"] == 2


def test_a_recording_without_a_depth_unit_is_one_line(tmp_path):
    opened = player(tmp_path, repeat=False)
    header = (tmp_path / "camera.json").read_text(encoding="ascii")
    (tmp_path / "camera.json").write_text(header.replace("depth_unit_m", "unit"), encoding="ascii")
    with pytest.raises(ValueError, match=r"camera\.json: depth_unit_m is missing"):
        opened()


def test_a_camera_that_is_unplugged_is_opened_again():
    silent = Scripted(frame(HELD, 1), *[NOTHING] * (camera_port.SILENT_READS + 5))
    cameras = Cameras(silent, Scripted(frame(HELD, 7)))
    got, _ = delivered(cameras, 2)
    assert [message.frame_number for message in got] == [1, 7]
    assert silent.closed and len(silent.reads) == 5


def test_a_camera_that_is_not_there_yet_is_looked_for_again():
    opened = threading.Event()

    def later():
        if not opened.is_set():
            opened.set()
            raise RuntimeError("no device connected")
        return Scripted(frame(HELD, 4))

    got, port = delivered(later, 1)
    assert got[0].frame_number == 4
    assert port.counts["unopened"] == 1 and port.last_error


def test_the_heartbeat_says_why_there_is_no_picture():
    pacing, port = Pacing(), None

    def fails_once():
        pacing.set = port.counts["unopened"] == 1  # this is the last attempt
        raise RuntimeError("no device connected")

    port = CameraPort(fails_once, clock=pacing)
    port._stop = pacing
    driven = DrivenPerception(camera=port.report)
    assert driven.words == "searching" and "camera_unopened" not in driven.fields
    port._run()
    assert driven.words == "searching; camera: no device connected"
    assert driven.fields["camera_unopened"] == 2
    port._pass_on(frame(HELD, 1))
    assert driven.words == "searching" and driven.fields["camera_frames"] == 1


def test_the_camera_of_a_recording_is_in_the_heartbeat(tmp_path):
    residuals = Residuals(views=9, pixels_rms=0.2, position_mm=0.1, rotation_deg=0.1)
    matrix = ((613.0, 0.0, 320.0), (0.0, 613.0, 240.0), (0.0, 0.0, 1.0))
    Calibration(
        serial="", date="2026-01-01", case="jig", image_size=(640, 480), camera_matrix=matrix,
        camera_in_palm=Pose(), residuals=residuals,
    ).save(tmp_path / "calibration.yaml")  # fmt: skip
    source = {"kind": "recording", "path": str(tmp_path / "gone")}
    own = PerceptionConfig(source=source, calibration=tmp_path / "calibration.yaml")
    built = build(PerceptionProcess(task="die", run_dir=tmp_path, perception=own), 5)
    port = built.ports["camera"]
    port._note("unopened", "gone")
    assert built.service.report().state == "searching; camera: gone"


def test_it_takes_no_commands():
    with pytest.raises(TypeError, match="takes no ArmReply"):
        CameraPort(Cameras()).write(ArmReply(True, "", ""))


def test_sources_are_found_by_what_they_are(tmp_path):
    recorder = Recorder(tmp_path / "frames")
    recorder.write(frame(HELD, 1))
    recorder.close()
    assert source_at(tmp_path / "frames").read(0).frame_number == 1
    (tmp_path / "camera.yaml").write_text(f"kind: recording\npath: {tmp_path}/frames\nrepeat: true")
    source = source_at(tmp_path / "camera.yaml")
    assert [source.read(0).frame_number for _ in range(3)] == [1, 1, 1]
    with pytest.raises(ValueError, match=r"source\.path: missing"):
        open_source(SourceConfig(kind="recording"))


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"die": "pink"}, "perception.die: pink is neither a file nor one of white, black"),
        (
            {"source": {"kind": "recording", "path": "x"}},
            "perception.calibration: missing: where is the camera",
        ),
        ({"aruco": {"marker_m": 0.07}, "backend": "aruco"}, "perception: aruco.marker_m"),
    ],
)
def test_what_does_not_fit_together_is_one_line(changes, message):
    config = PerceptionProcess(task="die", perception=PerceptionConfig(**changes))
    with pytest.raises(ConfigError, match=message):
        build(config, 5)


def test_the_emulated_cameras_own_k_is_expected_of_its_pictures():
    camera = CameraConfig()
    place = place_of(PerceptionConfig(), camera)
    assert place.misfit(camera.camera_matrix) == "" and place.tag is None
    other = camera.camera_matrix * np.array([[0.5], [0.5], [1.0]])
    assert "pictures have fx 306.6, camera.focal_px says 613.2" in place.misfit(other)
    assert np.array_equal(place.T_palm_camera, camera.T_palm_camera)

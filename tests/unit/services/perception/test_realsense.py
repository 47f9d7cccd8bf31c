"""The RealSense source, against the SDK's software device and, where there is one, a real recording."""

from pathlib import Path

import numpy as np
import pytest

from services.perception.frames import Frame, Refusal, Refused

rs = pytest.importorskip(
    "pyrealsense2", exc_type=ImportError, reason="the extra `realsense` or libusb-1.0-0 is not installed"
)
from services.perception.realsense import RealsenseSource, Stream, playback  # noqa: E402

WIDTH, HEIGHT = 64, 48
DEPTH_FOCAL, COLOUR_FOCAL, ASIDE_M = 40.0, 60.0, 0.015
PERIOD_MS = 33.0


def lens(focal_px):
    made = rs.intrinsics()
    made.width, made.height, made.fx, made.fy = WIDTH, HEIGHT, focal_px, focal_px
    made.ppx, made.ppy, made.model, made.coeffs = 31.5, 23.5, rs.distortion.brown_conrady, [0] * 5
    return made


def video(kind, uid, pixel_format, bytes_per_pixel, focal_px):
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fps = kind, 0, uid, 30
    stream.width, stream.height, stream.bpp, stream.fmt = WIDTH, HEIGHT, bytes_per_pixel, pixel_format
    stream.intrinsics = lens(focal_px)
    return stream


class Camera:
    """The SDK's software device: whatever is pushed comes out of its syncer."""

    def __init__(self):
        self.device = rs.software_device()
        self.depth, self.colour = self.device.add_sensor("Depth"), self.device.add_sensor("Colour")
        depth = video(rs.stream.depth, 0, rs.format.z16, 2, DEPTH_FOCAL)
        colour = video(rs.stream.color, 1, rs.format.rgb8, 3, COLOUR_FOCAL)
        self.profiles = self.depth.add_video_stream(depth), self.colour.add_video_stream(colour)
        self.depth.add_read_only_option(rs.option.depth_units, 0.001)
        place = rs.extrinsics()
        place.rotation, place.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [ASIDE_M, 0, 0]
        self.profiles[0].register_extrinsics_to(self.profiles[1], place)
        self.device.create_matcher(rs.matchers.default)
        self.syncer = rs.syncer(100)
        for sensor, profile in ((self.depth, self.profiles[0]), (self.colour, self.profiles[1])):
            sensor.open(profile)
            sensor.start(self.syncer)

    def push(self, sensor, number, time_ms, pixels):
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp = pixels, pixels.dtype.itemsize * (pixels.ndim == 2 or 3)
        frame.stride = WIDTH * frame.bpp
        frame.timestamp, frame.frame_number = time_ms, number
        frame.domain = rs.timestamp_domain.hardware_clock
        frame.profile = self.profiles[sensor is self.colour].as_video_stream_profile()
        if sensor is self.depth:
            frame.depth_units = 0.001
        sensor.on_video_frame(frame)

    def close(self):
        for sensor in (self.depth, self.colour):
            sensor.stop()
            sensor.close()


@pytest.fixture
def camera():
    made = Camera()
    yield made
    made.close()


def shoot(camera, source, skew_ms, count=8):
    """Push pairs and read all that comes of them."""
    depth = np.full((HEIGHT, WIDTH), 500, np.uint16)
    colour = np.full((HEIGHT, WIDTH, 3), (200, 10, 30), np.uint8)
    read = []
    for number in range(count):
        camera.push(camera.depth, number, 1000 + PERIOD_MS * number, depth)
        camera.push(camera.colour, number, 1000 + PERIOD_MS * number + skew_ms, colour)
        read.append(source.read(0.2))
    return read


def test_software_device(camera):
    source = RealsenseSource(Stream(camera.syncer, lambda: None, lambda: False, live=False))
    read = shoot(camera, source, skew_ms=1.0)
    frames = [one for one in read if isinstance(one, Frame)]
    # The SDK's syncer breaks pairs up at will; each broken one is refused as such.
    assert {one.reason for one in read if isinstance(one, Refused)} <= {Refusal.INCOMPLETE, Refusal.TIMEOUT}
    assert frames
    for frame in frames:
        assert (frame.colour == (200, 10, 30)).all()
        assert frame.depth_unit_m == pytest.approx(0.001)
        assert frame.skew_ns == 1_000_000
        assert frame.depth_time_ns == round((1000 + PERIOD_MS * frame.frame_number) * 1e6)
        assert np.array_equal(frame.camera_matrix, [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]])
    # Depth's picture is the wider one, so it fills colour's.
    assert (frames[0].depth == 500).mean() > 0.95


def test_pictures_apart_in_time_are_refused(camera):
    source = RealsenseSource(Stream(camera.syncer, lambda: None, lambda: False, live=False))
    read = shoot(camera, source, skew_ms=12.0)
    assert not [one for one in read if isinstance(one, Frame)]
    skewed = [one for one in read if one.reason is Refusal.SKEW]
    assert skewed
    assert "+12.0 ms" in skewed[0].message


class Broken:
    """A queue as the SDK shows it when the cable is pulled."""

    def try_wait_for_frames(self, timeout_ms):
        raise RuntimeError("Device disconnected")


class Silent:
    def try_wait_for_frames(self, timeout_ms):
        return False, None


def source_of(queue, over=False):
    stopped = []
    source = RealsenseSource(Stream(queue, lambda: stopped.append(1), lambda: over, live=True))
    return source, stopped


def test_a_pulled_cable_and_silence_are_told_not_raised():
    pulled = source_of(Broken())[0].read(0.01)
    assert (pulled.reason, "disconnected" in pulled.message) == (Refusal.TIMEOUT, True)
    assert source_of(Silent())[0].read(0.01).reason is Refusal.TIMEOUT
    assert source_of(Silent(), over=True)[0].read(0.01).reason is Refusal.ENDED


def test_closed_twice_it_is_stopped_once_and_gives_nothing():
    source, stopped = source_of(Silent())
    source.close()
    source.close()
    assert stopped == [1]
    assert source.read(0.01).reason is Refusal.ENDED


def test_a_file_that_is_no_recording_is_an_error(tmp_path):
    path = tmp_path / "no.bag"
    path.write_bytes(b"#ROSBAG V2.0\nnothing")
    with pytest.raises(RuntimeError):
        playback(path)


@pytest.fixture
def recording(request):
    path = Path(request.config.getoption("--d435-recording"))
    if not path.is_file():
        pytest.skip("no recording of a real D435: give --d435-recording=PATH")
    return path


def test_a_real_d435(recording):
    """One pair of a room, taken at 6 Hz: 268 ms apart, which the default refuses, as it should."""
    source = RealsenseSource(playback(recording))
    refused = source.read(5.0)
    source.close()
    assert refused.reason is Refusal.SKEW
    source = RealsenseSource(playback(recording), max_skew_ns=300_000_000)
    frame = source.read(5.0)
    assert source.read(1.0).reason is Refusal.ENDED
    source.close()
    assert frame.skew_ns == -268_242_000
    assert frame.depth_unit_m == pytest.approx(0.001)
    expected = [[613.204, 0, 319.939], [0, 613.419, 239.183], [0, 0, 1]]
    assert np.allclose(frame.camera_matrix, expected, atol=1e-3)
    depth_m = frame.depth_m()
    assert (depth_m > 0).mean() > 0.8
    assert 0.3 < np.median(depth_m[depth_m > 0]) < 3.0
    assert 40 < frame.colour.mean() < 215

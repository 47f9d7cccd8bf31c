"""The calibration commands, from rendered views to a file that holds or does not."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from common.config import ConfigError, load
from services.perception import rigid
from services.perception.calibrate import main
from services.perception.calibration import Calibration
from services.perception.capture import read_poses
from services.perception.frames import Frame
from services.perception.plate import Plate, PlateConfig
from services.perception.recording import Player, Recorder
from tests.unit.services.perception.flat import (
    CAMERA_MATRIX,
    HEIGHT,
    WIDTH,
    developed,
    lay,
    looking,
    plate_picture,
)
from tests.unit.services.perception.test_palm_tag import blank, cv2, dictionary_of

PLATE = Plate(PlateConfig())
JIG = rigid.join((0.05, -0.02, 0.16), (0.5, 0.5, -0.5, 0.5))
MIDDLE = np.array([0.105, 0.075, 0.0])
CAMERA = looking(MIDDLE + np.array((0.1, 0.12, -0.4)), MIDDLE)  # T_camera_plate
TAG_NUMBER = 3
RIG = {
    "jig": {"position_m": [0.05, -0.02, 0.16], "rotation": [0.5, 0.5, -0.5, 0.5]},
    "tag": {"number": TAG_NUMBER},
    "serial": "012345",
    "views": 4,
}


def frame(colour, number):
    depth = np.full((HEIGHT, WIDTH), 420, np.uint16)
    return Frame(colour, depth, 0.001, CAMERA_MATRIX, number * 10**8, number * 10**8, number)


def plate_and_tag(T_camera_plate, seed):
    """The plate, and beside it a tag on the palm."""
    canvas = blank()
    lay(canvas, PLATE.picture(8000), T_camera_plate, (0.21, 0.15), centred=False)
    marker = cv2.aruco.generateImageMarker(dictionary_of("DICT_4X4_50"), TAG_NUMBER, 60)
    beside = T_camera_plate @ rigid.join((-0.04, 0.07, 0.0), (1, 0, 0, 0))
    lay(canvas, np.pad(marker, 12, constant_values=255), beside, (0.042, 0.042), centred=True)
    return developed(canvas, 2.0, seed)


def recorded(folder, pictures):
    recorder = Recorder(folder)
    for number, colour in enumerate(pictures):
        recorder.write(frame(colour, number))
    recorder.close()
    return folder


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate")
    (folder / "rig.yaml").write_text(yaml.safe_dump(RIG))
    good = [plate_and_tag(CAMERA, seed) for seed in range(4)]
    blurred = cv2.GaussianBlur(good[0], (0, 0), 1.7)
    recorded(folder / "camera", [blurred, *good[:2], np.zeros_like(blurred), *good[2:]])
    assert main(["capture", *words(folder, "rig.yaml", "camera", "views")]) == 0
    assert main(["solve", *words(folder, "rig.yaml", "views"), "--out", str(folder / "c.yaml")]) == 0
    return folder


def words(folder, *names):
    return [str(folder / name) for name in names]


def test_capture_keeps_good_views_only(place):
    assert [view.frame_number for view in read_all(place / "views")] == [1, 2, 4, 5]


def read_all(folder):
    player = Player(folder)
    return [player.load(n) for n in range(len(player))]


def test_solve_writes_where_the_camera_is(place):
    calibration = load(Calibration, place / "c.yaml")
    expected = JIG @ rigid.inverse(CAMERA)
    assert calibration.T_palm_camera == pytest.approx(expected, abs=1e-3)
    assert np.allclose(calibration.K, CAMERA_MATRIX)
    assert (calibration.serial, calibration.case, calibration.image_size) == ("012345", "jig", (640, 480))
    assert calibration.residuals.views == 4 and calibration.residuals.pixels_rms < 0.2
    assert calibration.tag.number == TAG_NUMBER


def test_verify_holds_where_nothing_moved_and_draws_it(place, tmp_path, capsys):
    picture = tmp_path / "axes.png"
    told = main(["verify", *words(place, "rig.yaml", "c.yaml", "views"), "--picture", str(picture)])
    lines = capsys.readouterr().out.splitlines()
    assert told == 0 and [line[:4] for line in lines] == ["ok  "] * 3
    assert lines[0] == "ok    intrinsics are those calibrated"
    drawn = cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2RGB)
    assert (drawn != read_all(place / "views")[0].colour).any(axis=-1).sum() > 100


def test_verify_notices_a_knocked_camera(place, tmp_path, capsys):
    moved = rigid.join((0.004, 0, 0), (1, 0, 0, 0)) @ CAMERA
    recorded(tmp_path / "moved", [plate_and_tag(moved, 9)])
    assert main(["verify", *words(place, "rig.yaml", "c.yaml"), str(tmp_path / "moved")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("FAIL  palm's tag 5.") and lines[2].startswith("FAIL  plate 4.")


def test_verify_notices_another_stream(place, tmp_path, capsys):
    other = replace(frame(plate_and_tag(CAMERA, 1), 0), camera_matrix=CAMERA_MATRIX * [[0.9], [0.9], [1.0]])
    recorder = Recorder(tmp_path / "other")
    recorder.write(other)
    recorder.close()
    assert main(["verify", *words(place, "rig.yaml", "c.yaml"), str(tmp_path / "other")]) == 1
    assert "FAIL  pictures have fx 551.7" in capsys.readouterr().out


def test_verify_of_a_picture_that_shows_nothing_does_not_pass(place, tmp_path, capsys):
    recorded(tmp_path / "empty", [np.full((HEIGHT, WIDTH, 3), 90, np.uint8)])
    assert main(["verify", *words(place, "rig.yaml", "c.yaml"), str(tmp_path / "empty")]) == 1
    assert "neither the palm's tag nor the jigged plate" in capsys.readouterr().out


def test_a_camera_that_rides_with_the_palm(tmp_path, capsys, monkeypatch):
    """Poses of the arm are asked for one by one, kept with the views, and used by `solve`."""
    rng = np.random.default_rng(2)
    T_palm_camera = rigid.join((0.05, 0.02, -0.03), (0.5, -0.5, 0.5, 0.5))
    cameras = []
    for _ in range(7):
        off = [0.42 * np.sin(rng.uniform(0.3, 0.7)), rng.choice((-0.25, 0.25)), -0.38]
        cameras.append(looking(MIDDLE + off, MIDDLE, rng.uniform(-0.8, 0.8)))
    arm = [rigid.inverse(T_palm_camera @ pose) for pose in cameras]
    lines = [" ".join(map(str, (*p, *q))) for p, q in map(rigid.split, arm)]
    (tmp_path / "poses.txt").write_text("# from the arm\n" + "\n".join(lines))
    (tmp_path / "rig.yaml").write_text("{}")
    recorded(tmp_path / "camera", [plate_picture(PLATE, pose) for pose in cameras])
    asked = []
    monkeypatch.setattr("builtins.input", asked.append)
    poses = ["--poses", str(tmp_path / "poses.txt")]
    assert main(["capture", *words(tmp_path, "rig.yaml", "camera", "views"), *poses]) == 0
    assert len(asked) == 7 and asked[0].startswith("move the palm to pose 1 of 7: ")
    out = str(tmp_path / "c.yaml")
    assert main(["solve", *words(tmp_path, "rig.yaml", "views"), "--case", "hand_eye", "--out", out]) == 0
    assert "nobody will notice a knocked camera" in capsys.readouterr().out
    assert load(Calibration, tmp_path / "c.yaml").T_palm_camera == pytest.approx(T_palm_camera, abs=1e-3)


@pytest.mark.parametrize(
    "command, message",
    [
        ("solve {rig} {nothing}", "camera.json: no camera recording"),
        ("solve {missing} {views}", "missing.yaml: cannot be read"),
        ("solve {no_jig} {views}", "the rig file has no jig"),
        ("solve {rig} {views} --case robot_world", "poses.txt"),
        ("capture {rig} {views} {views}", "File exists"),
        ("capture {many} {views} {new}", "the camera gives no more pictures"),
        ("verify {rig} {rig} {views}", "rig.yaml: plate: no such key"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(place, tmp_path, capsys, command, message):
    (tmp_path / "no_jig.yaml").write_text("{}")
    (tmp_path / "many.yaml").write_text("views: 99")
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({**RIG, "plate": {"square_m": 0.03}}))
    (tmp_path / "nothing").mkdir()
    paths = {"rig": tmp_path / "rig.yaml", "views": place / "views", "nothing": tmp_path / "nothing"}
    paths |= {name: tmp_path / f"{name}.yaml" for name in ("missing", "no_jig", "many")}
    assert main(command.format(**paths, new=tmp_path / "new").split()) == 2
    assert message in capsys.readouterr().err


def test_the_plate_is_drawn_to_scale(tmp_path, capsys):
    (tmp_path / "rig.yaml").write_text("plate: {squares: [5, 4], square_m: 0.0254, marker_m: 0.02}")
    assert main(["plate", *words(tmp_path, "rig.yaml", "plate.png")]) == 0
    assert cv2.imread(str(tmp_path / "plate.png")).shape[:2] == (2400, 3000)
    assert "at 600 dpi" in capsys.readouterr().out


@pytest.mark.parametrize("line", ["1 2 3", "0 0 0 1 1 0 0", "a b c d e f g", "0 0 nan 1 0 0 0"])
def test_a_bad_pose_is_named(tmp_path, line):
    path = tmp_path / "poses.txt"
    path.write_text(f"0 0 0 1 0 0 0\n{line}\n")
    with pytest.raises(ValueError, match=r"poses.txt:2: a pose is x y z in metres and a unit quaternion"):
        read_poses(path)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"camera_matrix": [[0, 0, 1], [0, 1, 1], [0, 0, 1]]}, "camera_matrix must be"),
        ({"camera_in_palm": {"rotation": [1, 1, 0, 0]}}, "rotation must have norm 1"),
        ({"residuals": {}}, "residuals.views: field required"),
    ],
)
def test_a_damaged_calibration_is_refused(place, tmp_path, change, message):
    content = yaml.safe_load((place / "c.yaml").read_text()) | change
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=message):
        load(Calibration, tmp_path / "bad.yaml")

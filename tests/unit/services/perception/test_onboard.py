"""An unknown die is learned from pictures of its faces; what is no face is told, not guessed."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from common.config import ConfigError
from common.die import DIE, Die
from common.die_file import read_die, write_die
from services.perception.face_fit import FaceFit, fit_face
from services.perception.frames import Frame
from services.perception.onboard import OnboardError, combine, main
from services.perception.recording import Recorder

K = np.array([[600.0, 0.0, 160.0], [0.0, 600.0, 120.0], [0.0, 0.0, 1.0]])
RED = Die(0.05, pip_radius_m=0.0042, pip_spacing_m=0.0125, body_rgb=(170, 30, 40), pip_rgb=(235, 230, 225))
WALL_M = 0.6


def picture(die, face, number=0, turn_deg=20.0, tilt_deg=25.0):
    """A face of the die, turned and tilted, 0.4 m before a wall."""
    turn, tilt = np.radians((turn_deg, tilt_deg))
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    rotation, centre = about_y @ about_z, np.array([0.01, -0.005, 0.4])
    drawn = die.face_image(face, 200)
    scale = die.size_m / 200
    to_face = np.array(
        [[scale, 0, 0.5 * scale - die.half_m], [0, scale, 0.5 * scale - die.half_m], [0, 0, 1]]
    )
    warp = K @ np.column_stack([rotation[:, :2], centre]) @ to_face
    colour = cv2.warpPerspective(drawn, warp, (320, 240), borderValue=(90, 120, 90))
    on_face = cv2.warpPerspective(np.ones((200, 200), np.uint8), warp, (320, 240)) > 0
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - 160.0) / 600.0, (v - 120.0) / 600.0, np.ones_like(u, float)], axis=-1)
    depth = np.where(on_face, rotation[:, 2] @ centre / (rays @ rotation[:, 2]), WALL_M)
    t_ns = 1_000_000_000 + 33_000_000 * number
    return Frame(colour, np.rint(depth * 1e4).astype(np.uint16), 1e-4, K, t_ns, t_ns, number)


@pytest.mark.parametrize("face", range(1, 7))
@pytest.mark.parametrize("die", [DIE, RED], ids=["white", "red"])
def test_a_face_is_read_without_knowing_the_die(die, face):
    fit = fit_face(picture(die, face), die.size_m)
    assert isinstance(fit, FaceFit)
    assert fit.pips == face
    assert np.allclose(fit.body_rgb, die.body_rgb, atol=3)
    assert np.allclose(fit.pip_rgb, die.pip_rgb, atol=8)
    assert fit.pip_radius_m == pytest.approx(die.pip_radius_m, rel=0.06)
    assert (
        fit.pip_spacing_m is None
        if face == 1
        else fit.pip_spacing_m == pytest.approx(die.pip_spacing_m, rel=0.04)
    )


def test_another_size_is_no_such_die():
    assert "no flat square of 80 mm" in fit_face(picture(DIE, 5), 0.080)


def test_without_depth_there_is_nothing():
    blind = replace(picture(DIE, 5), depth=np.zeros((240, 320), np.uint16))
    assert "no flat square" in fit_face(blind, 0.060)


def test_a_blank_cube_is_no_die():
    blank = picture(replace(DIE, pip_radius_m=1e-6), 6)
    assert isinstance(fit_face(blank, 0.060), str)


def test_faces_together_are_a_die():
    die = combine([fit_face(picture(RED, face), RED.size_m) for face in (1, 4, 6)], RED.size_m, 0.003)
    assert die.light_pips
    assert (die.size_m, die.corner_radius_m) == (0.05, 0.003)
    assert die.pip_spacing_m == pytest.approx(RED.pip_spacing_m, rel=0.03)


def test_ones_alone_leave_the_spacing_open():
    with pytest.raises(OnboardError, match="another one"):
        combine([fit_face(picture(DIE, 1), 0.060)], 0.060, 0.004)


def test_the_command_writes_a_die_that_can_be_read(tmp_path, capsys):
    recorder = Recorder(tmp_path / "seen")
    for number, face in enumerate((6, 2, 3)):
        recorder.write(picture(RED, face, number))
    recorder.close()
    out = tmp_path / "die.yaml"
    assert main(["--source", str(tmp_path / "seen"), "--out", str(out), "--size-mm", "50"]) == 0
    assert "light pips on a dark body" in capsys.readouterr().out
    die = read_die(out)
    assert die.pip_radius_m == pytest.approx(RED.pip_radius_m, rel=0.05)
    assert np.allclose(die.body_rgb, RED.body_rgb, atol=3)


@pytest.mark.parametrize(("source", "code"), [("absent", 2), ("empty", 1)])
def test_the_command_says_why_it_failed(tmp_path, capsys, source, code):
    folder = tmp_path / "empty"
    recorder = Recorder(folder)
    recorder.write(replace(picture(DIE, 5), depth=np.zeros((240, 320), np.uint16)))
    recorder.close()
    arguments = ["--source", str(tmp_path / source), "--out", str(tmp_path / "d.yaml"), "--size-mm", "60"]
    assert main(arguments) == code
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "d.yaml").exists()


def test_a_die_survives_its_file(tmp_path):
    die = replace(RED, quarters=(0, 1, 1, 0, 0, 3), right_handed=False)
    write_die(tmp_path / "die.yaml", die)
    assert read_die(tmp_path / "die.yaml") == die


@pytest.mark.parametrize(
    "text", ["size_mm: 60", "size_m: 60", "body_rgb: [1, 2]", "pip_rgb: [1, 2, 256]", "- 1"]
)
def test_a_wrong_file_is_refused(tmp_path, text):
    (tmp_path / "die.yaml").write_text(text)
    with pytest.raises(ConfigError):
        read_die(tmp_path / "die.yaml")

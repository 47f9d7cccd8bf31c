"""What is recorded comes back bit for bit; what is damaged or out of order is refused, the rest plays."""

from dataclasses import replace

import numpy as np
import pytest

from services.perception import record as recording_command
from services.perception.frames import Frame, Refusal, Refused
from services.perception.recording import Player, Recorder

K = np.array([[613.25, 0.0, 10.5], [0.0, 613.75, 6.5], [0.0, 0.0, 1.0]])


def frame(number):
    rng = np.random.default_rng(number)
    colour = rng.integers(0, 256, (12, 20, 3), np.uint8)
    depth = rng.integers(0, 65536, (12, 20), np.uint16)
    return Frame(colour, depth, 1e-4, K, 10_000_001 * number, 10_000_001 * number - 7, number)


def record(folder, frames):
    recorder = Recorder(folder)
    for one in frames:
        recorder.write(one)
    recorder.close()
    return folder


def same(left, right):
    return (
        np.array_equal(left.colour, right.colour)
        and np.array_equal(left.depth, right.depth)
        and np.array_equal(left.camera_matrix, right.camera_matrix)
        and (left.depth_unit_m, left.colour_time_ns, left.depth_time_ns, left.frame_number)
        == (right.depth_unit_m, right.colour_time_ns, right.depth_time_ns, right.frame_number)
    )


def play(folder):
    player = Player(folder)
    read = []
    while not (isinstance(last := player.read(), Refused) and last.reason is Refusal.ENDED):
        read.append(last)
    return read


def test_frames_come_back_as_they_were(tmp_path):
    frames = [frame(1), frame(2), frame(5)]
    read = play(record(tmp_path / "a", frames))
    assert len(read) == 3
    assert all(map(same, frames, read))


def test_repeated_it_begins_again(tmp_path):
    player = Player(record(tmp_path, [frame(1), frame(2)]), repeat=True)
    assert [player.read().frame_number for _ in range(5)] == [1, 2, 1, 2, 1]


def test_a_damaged_picture_costs_only_its_frame(tmp_path):
    record(tmp_path, [frame(1), frame(2), frame(3)])
    (tmp_path / "depth_000001.png").write_bytes(b"not a picture")
    first, damaged, last = play(tmp_path)
    assert (first.frame_number, damaged.reason, last.frame_number) == (1, Refusal.INVALID, 3)
    assert "depth_000001.png" in damaged.message


def test_swapped_pictures_are_refused(tmp_path):
    record(tmp_path, [frame(1)])
    (tmp_path / "colour_000000.png").rename(tmp_path / "x")
    (tmp_path / "depth_000000.png").rename(tmp_path / "colour_000000.png")
    (tmp_path / "x").rename(tmp_path / "depth_000000.png")
    assert [refused.reason for refused in play(tmp_path)] == [Refusal.INVALID]


def test_time_running_backwards_is_refused(tmp_path):
    frames = [frame(2), replace(frame(1), frame_number=9), frame(3)]
    assert [getattr(x, "reason", None) for x in play(record(tmp_path, frames))] == [
        None,
        Refusal.BACKWARDS,
        None,
    ]


def test_a_recording_cut_off_in_mid_line_plays_up_to_there(tmp_path):
    record(tmp_path, [frame(1), frame(2)])
    index = tmp_path / "frames.jsonl"
    index.write_text(index.read_text()[:-9])
    assert [x.frame_number for x in play(tmp_path)] == [1]


@pytest.mark.parametrize("change", [{"depth_unit_m": 1e-3}, {"camera_matrix": np.diag([9.0, 9.0, 1.0])}])
def test_another_camera_needs_another_recording(tmp_path, change):
    recorder = Recorder(tmp_path)
    recorder.write(frame(1))
    with pytest.raises(ValueError, match="camera changed"):
        recorder.write(replace(frame(2), **change))
    recorder.close()


def test_a_recording_is_never_overwritten(tmp_path):
    record(tmp_path, [frame(1)])
    with pytest.raises(FileExistsError):
        Recorder(tmp_path)


@pytest.mark.parametrize("content", [None, "{}", "[1]", "{"])
def test_what_is_no_recording_is_named(tmp_path, content):
    if content is not None:
        (tmp_path / "camera.json").write_text(content)
    with pytest.raises(ValueError, match=r"camera\.json"):
        Player(tmp_path)


def test_the_command_keeps_what_a_source_gives(tmp_path, capsys):
    source = record(tmp_path / "source", [frame(1), frame(3), frame(2), frame(4), frame(5)])
    kept = tmp_path / "kept"
    assert recording_command.main([str(source), str(kept), "--frames", "3"]) == 0
    assert all(same(a, b) for a, b in zip(play(kept), [frame(1), frame(3), frame(4)], strict=True))
    said = capsys.readouterr()
    assert said.out == f"{kept}: 3 frames, 1 refused: backwards\n"
    assert "frame 2 was not captured after frame 3" in said.err


def test_the_command_ends_with_its_source_and_says_what_it_cannot_use(tmp_path, capsys):
    source = record(tmp_path / "source", [frame(1), frame(2)])
    assert recording_command.main([str(source), str(tmp_path / "kept")]) == 0
    assert len(play(tmp_path / "kept")) == 2
    assert recording_command.main([str(source), str(tmp_path / "kept")]) == 2
    assert "kept" in capsys.readouterr().err
    assert recording_command.main([str(tmp_path / "nowhere.yaml"), str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()


class Interrupted:
    """A person presses Ctrl-C after two frames."""

    def __init__(self):
        self.left = [frame(1), frame(2)]

    def read(self, timeout_s):
        if not self.left:
            raise KeyboardInterrupt
        return self.left.pop(0)

    def close(self):
        pass


def test_ctrl_c_ends_a_recording_that_plays(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(recording_command, "source_at", lambda path: Interrupted())
    assert recording_command.main(["camera.yaml", str(tmp_path / "kept")]) == 0
    assert "2 frames" in capsys.readouterr().out
    assert len(play(tmp_path / "kept")) == 2

import json
from pathlib import Path

import pytest

from deploy.curve import draw, in_people_units, mean, read_episodes, running_mean
from deploy.progress import figures, summary


def row(episode: int, mode: str, **values: object) -> dict[str, object]:
    return {"episode": episode, "mode": mode, "trained_episodes": episode, "return": -1.0, **values}


ROWS = [
    row(0, "random", error_tips_m=0.05),
    row(1, "plan", error_tips_m=0.02, success_paper=False),
    row(2, "plan", error_tips_m=0.01, success_paper=True) | {"return": None},
    row(3, "evaluate", error_tips_m=0.004, success_paper=True),
]


def written(directory: Path) -> Path:
    path = directory / "episodes.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in ROWS) + '{"episode": 4, "mo', encoding="utf-8")
    return path


def test_a_line_cut_short_is_left_out(tmp_path: Path) -> None:
    assert read_episodes(written(tmp_path)) == ROWS
    assert read_episodes(tmp_path / "none.jsonl") == []


def test_units_for_people() -> None:
    assert in_people_units("error_mean_finger_m", 0.0123) == ("mean finger, mm", pytest.approx(12.3))
    assert in_people_units("error_rotation_rad", 3.14159265) == ("rotation, °", pytest.approx(180.0))


def test_means_leave_out_what_is_unknown() -> None:
    assert mean("return", ROWS) == -1.0
    assert mean("error_tips_m", ROWS[1:3]) == pytest.approx(15.0)
    assert mean("nothing", ROWS) is None
    assert running_mean([1.0, 2.0, 3.0, 4.0], width=2) == [1.0, 1.5, 2.5, 3.5]


def test_summary_tells_modes_apart(tmp_path: Path) -> None:
    written(tmp_path)
    lines = summary(tmp_path)
    assert [line.split()[-3:] for line in lines] == [
        ["random", "plan", "evaluate"],
        ["1", "2", "1"],
        ["-1", "-1", "-1"],
        ["50", "15", "4"],
        ["–", "50%", "100%"],
    ]
    assert summary(tmp_path / "empty") == ["no episode was finished"]


def test_curve_is_drawn_once_something_was_planned(tmp_path: Path) -> None:
    assert draw(ROWS, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 5000
    assert not draw(ROWS[:1], tmp_path / "none.png")


def test_progress_shows_what_is_missing_as_missing() -> None:
    shown = figures({}, None)
    assert shown["episode"] == "–/–"
    assert shown["eta"] == "–"

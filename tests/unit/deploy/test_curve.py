import json
from dataclasses import replace
from pathlib import Path

import pytest

from deploy.curve import draw, in_people_units, mean, read_episodes, running_mean
from deploy.monitor import Heard
from deploy.progress import figures
from deploy.summary import summary, timing
from tests.unit.deploy.test_status import heard as health


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


def test_timing_counts_all_sessions_and_quotes_the_services() -> None:
    rows = [{"planned": 50, "late": 1, "held": 0}, {"planned": 150, "late": 2, "held": 1}, {"planned": 0}]
    heard = {
        name: Heard(replace(health(name).health, fields=fields), 0.1, 1)
        for name, fields in [
            ("sim", {"missed_ticks": 0.0}),
            ("planner", {"plan_ms_p50": 14.6, "plan_ms_p99": 30.0}),
            ("learner", {"updates": 1300.0, "updates_per_s": 7.94}),
        ]
    }
    told = "0 missed ticks, plans 15 ms p50, 30 p99, 1300 updates, 7.9 a second while training"
    assert timing(rows, heard) == [
        "planned steps  200: 3 late (1.5%), 1 held (0.5%)",
        f"this session   {told}",
    ]
    assert timing(rows, {}) == ["planned steps  200: 3 late (1.5%), 1 held (0.5%)"]
    assert timing([], heard) == [f"this session   {told}"]


def test_curve_is_drawn_once_something_was_planned(tmp_path: Path) -> None:
    assert draw(ROWS, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 5000
    assert not draw(ROWS[:1], tmp_path / "none.png")


def test_progress_shows_what_is_missing_as_missing() -> None:
    shown = figures({}, None)
    assert shown["episode"] == "–/–"
    assert shown["eta"] == "–"

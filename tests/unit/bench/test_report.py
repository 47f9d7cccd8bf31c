"""The results page and pictures: up to date with the committed rows, and every number the rows' own."""

import json

import pytest

from bench import report
from bench.outcomes import outcomes
from bench.pages import headline, page
from bench.report import Places, outdated, rewrite

COLUMNS = ("success_worst", "success_15d", "success_env", "success_reachable", "success_of_ceiling")


def row(task="reach", label="gc_pmpc_plus", seed=0, episode=100, goals=100, **changes):
    return {
        "task": task,
        "label": label,
        "seed": seed,
        "episode": episode,
        "goals": goals,
        "commit": "abc",
        "wall_s": 120.0,
        "cpu_s": {"plan": 30.0, "train": 60.0, "simulate": 30.0, "other": 0.0},
        "return_mean": -0.5,
        "success_paper": 0.5,
        **dict.fromkeys((*COLUMNS, "error_over_ceiling", "rot_error_rad", "pos_error_mm")),
        "mean_finger_error_mm": 3.0,
        **changes,
    }


def line(text, start):
    """The cells of the first line of a table that begins with `start`, after the heading `text`, if given."""
    found = next(each for each in text.splitlines() if each.startswith(f"| {start} |"))
    return [cell.strip() for cell in found.strip("|").split("|")]


def section(rows, heading, ceilings=None):
    return page(outcomes(rows), ceilings or {}).split(f"\n## {heading}")[1].split("\n## ")[0]


def test_the_documents_and_pictures_are_up_to_date():
    stale = [path.name for path in outdated(Places())]
    assert not stale, f"run `python -m bench.report`: {', '.join(stale)}"


def test_seeds_are_put_together_at_their_last_and_largest_evaluation():
    rows = [row(seed=seed, goals=20, success_paper=1.0) for seed in (0, 1)]
    rows += [row(seed=0, success_paper=0.4, mean_finger_error_mm=2.0), row(seed=1, success_paper=0.6)]
    cells = line(section(rows, "reach"), "`gc_pmpc_plus`")
    assert cells[1:5] == ["0, 1; missing 2", "100", "100", "50% (43–57)"]  # 100 of 200
    assert cells[8:] == ["–", "-0.50 ± 0.00", "2.50 ± 0.71", "2"]
    curve = outcomes(rows)["reach"]["gc_pmpc_plus"].curve("success_paper", 0)
    assert curve == {100: 1.0}  # the curve keeps to its own number of goals


def test_what_is_missing_is_shown_as_missing():
    text = page(outcomes([row()]), {})
    assert line(text, "`td7`") == ["`td7`", *["none"] * 4]
    assert set(line(section([row()], "reach"), "`td7`")[1:]) == {"–"}
    assert "case study" not in text
    assert "* A case study: [case_study_egg.md](case_study_egg.md)\n" in page({}, {}, ["case_study_egg.md"])
    assert "there is no run of it yet" in section([row()], "egg\n")
    assert line(headline(outcomes([row()]), {}), "egg") == ["egg", "–", "–", "–", "80%", "–"]


def test_everything_that_is_better_than_ours_is_named():
    rows = [row(), row(label="sac", return_mean=-0.4), row(label="td7", mean_finger_error_mm=2.5)]
    held = [{"budget": "held", "success_paper": True, "error_mean_finger_m": 0.001, "return": -0.2}] * 4
    text = section(rows, "reach", {"reach": held})
    assert [each for each in text.splitlines() if each.startswith("* ")][2:] == [
        "* `td7`: mean finger error, mm 2.50, ours 3.00.",
        "* `sac`: return -0.40, ours -0.50.",
        "* the true simulator allows 100% on 4 goals, ours is 50%.",
    ]


@pytest.mark.parametrize(
    ("changes", "aim", "verdict"),
    [
        ({"success_reachable": 0.9}, "at least 90 % of the goals whose", ("90%", "yes")),
        ({"success_reachable": 0.89}, "at least 90 % of the goals whose", ("89%", "no")),
        ({"mean_finger_error_mm": 2.1}, "mean finger error within", ("2.10 mm, held 1.00 mm", "no")),
        ({"return_mean": -0.22}, "return within", ("-0.22, held -0.20", "yes")),
        ({"return_mean": -0.24}, "return within", ("-0.24, held -0.20", "no")),
        ({}, "100 episodes, warm-up", ("2 min", "yes")),
    ],
)
def test_aims_are_judged(changes, aim, verdict):
    held = [{"budget": "held", "success_paper": True, "error_mean_finger_m": 0.001, "return": -0.2}]
    text = section([row(**changes)], "Aims", {"reach": held})
    cells = next(each for each in text.splitlines() if aim in each).strip("|").split("|")
    assert tuple(cell.strip() for cell in cells[2:]) == verdict


def test_steps_to_the_bar_count_the_warm_up_and_are_given_as_a_ratio():
    returns = {"gc_pmpc_plus": (-0.9, -0.7), "sac": (-2.0, -0.9), "sac_long": (-2.0, -0.78)}
    lengths = {"sac_long": 1100}
    rows = [
        row(label=label, episode=episode, return_mean=value)
        for label, values in returns.items()
        for episode, value in zip((0, lengths.get(label, 10)), values, strict=True)
    ]
    text = section(rows, "Steps to")
    assert line(text, "`gc_pmpc_plus`")[1:] == ["1 of 1", "5500 (5000)", "1.0", "5500"]
    assert line(text, "`sac`")[1:] == ["0 of 1", "–", "> 1.0", "5500"]
    assert line(text, "`sac_long`")[1:] == ["1 of 1", "60000 (5000)", "10.9", "60000"]


def test_ablations_stand_beside_ours_and_those_that_change_nothing_say_so():
    text = section([row(), row(label="x4", success_paper=0.1)], "Ablations")
    assert line(text, "`x4`")[2:6] == ["0; missing 1, 2", "10% (6–17)", "3.00", "-0.50"]
    assert line(text, "`no_dropout`")[2] == "the cell is so already"
    assert line(text, "`average`")[2] == "none"
    assert line(section([row()], "What a run"), "reach")[2:] == ["2", "25%", "50%", "25%", "0%", "2"]


def test_new_rows_make_page_pictures_and_headline_anew(tmp_path):
    (tmp_path / "rows").mkdir()
    places = Places(tmp_path / "rows", tmp_path / "pages", tmp_path / "README.md")
    places.readme.write_text("above\n<!-- result:headline -->\n<!-- /result:headline -->\nbelow\n")
    rows = [
        row(episode=episode, seed=seed, label=label)
        for episode in (0, 100)
        for seed in (0, 1)
        for label in ("sac", "gc_pmpc_plus")
    ]
    (places.results / "reach.jsonl").write_text("".join(json.dumps(each) + "\n" for each in rows))
    assert len(rewrite(places)) == 5 and outdated(places) == []
    text = places.readme.read_text()
    assert text.startswith("above\n") and text.endswith("below\n")
    assert line(text, "reach")[1:4] == ["50% (43–57)", "2, 100", "`sac` 50% (43–57)"]
    assert all(5_000 < (places.pages / name).stat().st_size < 500_000 for name in report.PICTURES)
    (places.results / "reach.jsonl").write_text(json.dumps(rows[0]) + "\n")
    assert len(outdated(places)) == 5

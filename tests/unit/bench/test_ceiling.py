"""Budgets grow until they do not help, no goal is scored twice, and results stand beside the reference."""

import json

import pytest

from bench.ceiling import ceiling, improved
from bench.references import best, reference_rows
from bench.result_rows import result_row, rows_of_run

LABELS = {"task": "egg_rotate", "method": "oracle"}


def goal(seed, rad, budget="a", **changes):
    return {
        "task": "egg_rotate",
        "budget": budget,
        "episode_seed": seed,
        "return": -10.0 * rad,
        "error_rotation_rad": rad,
        "error_position_m": 0.02,
        "success_paper": rad < 0.5,
        "success_env": rad < 0.1,
        **changes,
    }


def scorer(rad, calls):
    def score(seed):
        calls.append(seed)
        return {name: value for name, value in goal(seed, rad).items() if name not in ("task", "budget")}

    return score


def test_it_ends_at_the_first_budget_that_does_not_help_and_goes_on_where_it_was(tmp_path):
    calls = {name: [] for name in "abcd"}
    errors = {"a": 1.0, "b": 0.4, "c": 0.39, "d": 0.1}
    budgets = {name: scorer(rad, calls[name]) for name, rad in errors.items()}
    file = tmp_path / "rows.jsonl"
    file.write_text(json.dumps({**LABELS, **goal(7, 1.0)}) + "\n")
    rows = ceiling(budgets, (7, 8), LABELS, file)
    assert [calls[name] for name in "abcd"] == [[8], [7, 8], [7, 8], []]
    assert [json.loads(line)["budget"] for line in file.read_text().splitlines()] == [*"aabbcc"]
    assert {row["budget"] for row in best(rows)} == {"c"}  # as many goals as b, and nearer
    assert ceiling(budgets, (7, 8), LABELS, file) == rows and len(calls["b"]) == 2


def test_a_budget_helps_that_reaches_more_goals_or_comes_clearly_nearer():
    assert improved([goal(1, 0.6)], [goal(1, 0.49)])
    assert improved([goal(1, 2.0)], [goal(1, 1.8)])
    assert not improved([goal(1, 2.0)], [goal(1, 1.95)])


def test_an_unfinished_budget_is_no_reference(tmp_path):
    rows = [goal(1, 0.9), goal(2, 0.9), goal(1, 0.1, "b")]
    (tmp_path / "ceiling_egg_rotate.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert reference_rows("egg_rotate", [1, 2], tmp_path) == rows[:2]
    assert reference_rows("egg_rotate", [1, 2, 3], tmp_path) == []
    assert reference_rows("block", [1], tmp_path) == []


def test_success_stands_beside_the_oracles():
    rows = [goal(1, 0.3), goal(2, 0.7), goal(3, 0.9), goal(4, 0.05)]
    reference = [goal(seed, rad) for seed, rad in ((1, 0.2), (2, 0.2), (3, 0.2), (4, 0.6))]
    found = result_row({"task": "egg_rotate", "seed": 0}, rows, reference)
    assert (found["goals"], found["success_paper"], found["success_env"]) == (4, 0.5, 0.25)
    assert found["success_of_ceiling"] == pytest.approx(0.5 / 0.75, abs=1e-4)
    assert found["error_over_ceiling"] is found["success_worst"] is found["mean_finger_error_mm"] is None
    assert found["ci95"]["success_paper"] == [pytest.approx(0.15, abs=1e-2), pytest.approx(0.85, abs=1e-2)]
    assert (found["rot_error_rad"], found["pos_error_mm"]) == (0.4875, 20.0)
    assert found["return_mean"] == pytest.approx(-4.875)


def test_where_the_oracle_fails_errors_are_compared():
    rows, reference = [goal(1, 1.2, task="egg")], [goal(1, 1.0, error_position_m=0.01)]
    assert result_row({}, rows, reference)["error_over_ceiling"] == 2.0  # of position, the worse of the two
    assert result_row({}, [goal(1, 1.2)], reference)["error_over_ceiling"] == 1.2


def test_reach_counts_reachable_goals_alone():
    held = [{"episode_seed": s, "budget": "held", "success_paper": s < 3} for s in range(4)]
    rows = [{"episode_seed": s, "success_paper": s != 1, "return": -1.0} for s in range(4)]
    found = result_row({}, rows, held)
    assert found["success_paper"] == 0.75
    assert found["success_reachable"] == pytest.approx(2 / 3, abs=1e-4)
    assert found["success_of_ceiling"] is None


def test_a_runs_rows_leave_evaluations_out_of_its_cost(tmp_path):
    modes = ["random", "evaluate", "plan", "plan", "evaluate"]
    trained = [0, 0, 0, 1, 2]
    rows = [
        goal(5, 0.3, mode=mode, episode=i, trained_episodes=n, method="m") | {"task": "none", "seed": 3}
        for i, (mode, n) in enumerate(zip(modes, trained, strict=True))
    ]
    times = ((0, 0), (1, 4), (2, 9), (3, 10), (4, 13))
    notes = [
        {
            "session": 0,
            "episode": e,
            "wall_s": s,
            "cpu_s": {"plan": s / 2, "train": s / 4, "simulate": 0, "other": 0},
        }
        for e, s in times
    ]
    (tmp_path / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    (tmp_path / "timing.jsonl").write_text("".join(json.dumps(note) + "\n" for note in notes))
    (tmp_path / "sessions.jsonl").write_text(json.dumps({"commit": "abc", "cores": 2}) + "\n")
    found = rows_of_run(tmp_path)
    assert [(row["episode"], row["wall_s"]) for row in found] == [(0, 4.0), (2, 8.0)]
    assert [row["cpu_s"]["plan"] for row in found] == [2.0, 4.0]
    assert (found[0]["method"], found[0]["seed"], found[0]["commit"], found[0]["cores"]) == ("m", 3, "abc", 2)

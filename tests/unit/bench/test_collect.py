"""What of a run is committed, and what it takes the place of."""

import json

import pytest

from bench.collect import collect, committed_rows
from bench.references import reference_rows
from bench.result_rows import keep_evaluation, result_row


def goal(seed, error_m=0.003):
    return {
        "task": "reach",
        "episode_seed": seed,
        "error_mean_finger_m": error_m,
        "success_paper": error_m < 0.002,
        "return": -1.0,
    }


def make_run(directory, episodes=2, seed=0, *, wanted=None, cell="reach", error_m=0.003):
    about = {"task": "reach", "method": "sac", "seed": seed, "config_hash": f"h{seed}"}
    modes = ["random", "evaluate", *["plan"] * episodes, "evaluate"]
    trained = [0, 0, *range(episodes), episodes]
    rows = [
        {**about, "mode": mode, "episode": i, "trained_episodes": n, **goal(1_000_000, error_m)}
        for i, (mode, n) in enumerate(zip(modes, trained, strict=True))
    ]
    directory.mkdir(parents=True)
    (directory / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    (directory / "sessions.jsonl").write_text(json.dumps({"commit": "abc", "cores": 1}) + "\n")
    config = {
        "cell": cell,
        "task": "reach",
        "curriculum": {"episodes": wanted or episodes, "evaluate_goals": 1},
    }
    (directory / "config.yaml").write_text(json.dumps(config))
    return directory


def summary(results):
    names = ("label", "method", "seed", "episode", "goals")
    return [tuple(row[name] for name in names) for row in committed_rows(results)]


def test_a_run_is_committed_once_under_the_name_of_its_group(tmp_path):
    for name, seed in (("sac", 1), ("sac", 0), ("sac_long", 0)):
        make_run(tmp_path / "runs" / "reach" / name / str(seed), seed=seed)
    for _ in range(2):
        said = collect([tmp_path / "runs"], results=tmp_path)
    assert summary(tmp_path) == [
        (label, "sac", seed, episode, 1)
        for label, seed in (("sac", 0), ("sac", 1), ("sac_long", 0))
        for episode in (0, 2)
    ]
    assert said[0].endswith("reach/sac/0: 2 rows, in place of 2 of commit abc")


def test_a_run_replaces_the_one_of_its_task_label_and_seed_unless_that_has_come_further(tmp_path):
    collect([make_run(tmp_path / "old", episodes=2, error_m=0.003)], results=tmp_path)
    collect([make_run(tmp_path / "new", episodes=3, error_m=0.001)], results=tmp_path)
    assert [(row["episode"], row["success_paper"]) for row in committed_rows(tmp_path)] == [
        (0, 1.0),
        (3, 1.0),
    ]
    said = collect([tmp_path / "old"], results=tmp_path)
    assert "not collected: the committed run of this task, label and seed has come further" in said[0]
    assert summary(tmp_path)[-1] == ("sac", "sac", 0, 3, 1)


def test_the_evaluation_of_most_goals_is_the_final_row(tmp_path):
    run = make_run(tmp_path / "run")
    keep_evaluation(run, [goal(1_000_000)], "early")  # no more goals than the last point of the curve
    collect([run], results=tmp_path)
    assert summary(tmp_path) == [("sac", "sac", 0, n, 1) for n in (0, 2)]
    keep_evaluation(run, [goal(1_000_000 + i, 0.001 * (i + 1)) for i in range(4)], "later")
    collect([run], results=tmp_path)
    final = committed_rows(tmp_path)[-1]
    assert (final["episode"], final["goals"], final["success_paper"]) == (2, 4, 0.25)
    assert (final["commit"], final["evaluation_commit"], final["config_hash"]) == ("abc", "later", "h0")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"wanted": 9}, "2 of 9 episodes; --unfinished takes it as it is"),
        ({"cell": "debug"}, "cell debug is not the one of task reach"),
    ],
)
def test_what_is_no_result_is_named_and_left_out(tmp_path, changes, reason):
    said = collect([make_run(tmp_path / "run", **changes)], results=tmp_path)
    assert said == [f"{tmp_path / 'run'}: not collected: {reason}"]
    assert committed_rows(tmp_path) == []


def test_a_run_that_is_not_its_method_is_told_unless_it_has_a_name_of_its_own(tmp_path):
    for name in ("sac", "sac_more"):
        run = make_run(tmp_path / "reach" / name / "0")
        config = json.loads((run / "config.yaml").read_text())
        config |= {"seed": 7, "warmup_steps": 20_000, "model": {"members": 3, "gone_since": 1}}
        (run / "config.yaml").write_text(json.dumps(config))
    said = collect([tmp_path], results=tmp_path)
    assert [line.split(": ", 1)[1] for line in said] == [
        "2 rows; NOT sac as it is now: warmup_steps, model.members",
        "2 rows",
    ]


def test_an_unfinished_run_is_taken_when_asked_for(tmp_path):
    run = make_run(tmp_path / "run", wanted=9)
    collect([run], True, tmp_path)
    assert summary(tmp_path)[-1] == ("sac", "sac", 0, 2, 1)
    config = json.loads((run / "config.yaml").read_text())
    config["curriculum"]["evaluate_goals"] = 2  # the evaluation is going on
    (run / "config.yaml").write_text(json.dumps(config))
    assert collect([run], True, tmp_path) == [f"{run}: not collected: no complete evaluation"]


def test_a_long_evaluation_is_compared_with_the_ceiling_on_the_goals_that_it_knows(tmp_path):
    held = [{**goal(s, 0.001 if s < 20 else 0.003), "budget": "held"} for s in range(30)]
    (tmp_path / "ceiling_reach.jsonl").write_text("".join(json.dumps(row) + "\n" for row in held))
    reference = reference_rows("reach", range(100), tmp_path)
    assert [row["episode_seed"] for row in reference] == [*range(30)]
    assert reference_rows("reach", range(11, 100), tmp_path) == []  # 19 are too few
    ours = [goal(s, 0.001 if s % 4 == 0 or s >= 30 else 0.003) for s in range(100)]
    row = result_row({"task": "reach"}, ours, reference)
    assert (row["success_paper"], row["success_reachable"], row["ceiling_goals"]) == (0.78, 0.25, 30)

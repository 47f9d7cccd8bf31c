"""A sweep of tiny runs: on this machine, through submitit, and taken up again."""

import json

import pytest
import yaml

from bench import sweep
from common.config import ConfigError

TINY = [
    "warmup_steps=100",
    "learner.warmup_updates=5",
    "learner.updates_per_episode=2",
    "curriculum.episode_steps=10",
    "curriculum.evaluate_every=1",
    "curriculum.evaluate_goals=1",
]


def group(**changes):
    return {
        "tasks": ["debug"],
        "methods": ["gc_pmpc_plus"],
        "seeds": [0],
        "episodes": 1,
        "set": TINY,
        **changes,
    }


def parsed(tmp_path, *groups):
    return sweep.Sweep.model_validate({"out": tmp_path / "out", "groups": groups})


def test_every_combination_is_a_run_of_its_own(tmp_path):
    runs = sweep.runs_of(
        parsed(tmp_path, group(tasks=["reach", "egg"], seeds=[3, 4]), group(name="wide", methods=["pets"]))
    )
    names = [f"{task}/gc_pmpc_plus/{seed}" for task in ("reach", "egg") for seed in (3, 4)]
    assert [run.name for run in runs] == [*names, "debug/wide/0"]
    cell = runs[1].cell()
    assert (cell.seed, cell.curriculum.episodes, cell.warmup_steps) == (4, 1, 100)
    assert runs[4].cell().planner.propagation == "sampled"


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ([group(), group(set=[])], "debug/gc_pmpc_plus/0: two runs would share"),
        ([group(methods=["nonsense"])], "nonsense: no such method"),
        ([group(set=["a.b=1"])], "a: no such key"),
    ],
)
def test_a_mistake_is_found_before_anything_runs(tmp_path, groups, message):
    with pytest.raises(ConfigError, match=message):
        sweep.runs_of(parsed(tmp_path, *groups))


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    def start(groups, *options):
        file = tmp_path / "sweep.yaml"
        file.write_text(yaml.safe_dump({"out": str(tmp_path / "out"), "groups": groups}))
        monkeypatch.setattr("sys.argv", ["sweep", str(file), "--json", *options])
        with pytest.raises(SystemExit) as end:
            sweep.main()
        printed = capsys.readouterr()
        return end.value.code, json.loads(printed.out), printed.err

    return start


def test_runs_finish_here_and_are_not_run_again(tmp_path, command):
    code, found, _ = command([group()], "--jobs", "1")
    assert (code, found["runs"], found["finished"]) == (0, 1, 1)
    rows = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    assert [(row["task"], row["method"], row["episode"]) for row in rows] == [
        ("reach", "gc_pmpc_plus", n) for n in (0, 1)
    ]
    code, found, said = command([group(), group(name="other")], "--dry-run")
    assert (code, found["runs"], found["finished"]) == (0, 2, 1)
    assert "2 runs, 1 to do" in said and "debug/other/0: to do" in said


def test_the_same_file_runs_through_submitit_and_a_failure_stays_alone(tmp_path, command):
    pytest.importorskip("submitit")
    (tmp_path / "out" / "debug" / "blocked").mkdir(parents=True)
    (tmp_path / "out" / "debug" / "blocked" / "0").write_text("a file where a folder should be")
    code, found, said = command([group(name="blocked"), group()], "--cluster", "local")
    assert (code, found["finished"]) == (1, 1)
    assert "debug/blocked/0: FAILED" in said and "debug/gc_pmpc_plus/0: 1 episodes" in said

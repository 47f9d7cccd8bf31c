"""A sweep of tiny runs: on this machine, through submitit, and taken up again."""

import json
import os
import signal
from dataclasses import dataclass

import pytest
import yaml

from bench import sweep
from common.config import ConfigError, load
from deploy.supervisor import REPOSITORY

SWEEPS = sorted((REPOSITORY / "bench" / "sweeps").glob("*.yaml"))

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
    code, found, said = command([group(final_goals=2)], "--jobs", "1")
    assert (code, found["runs"], found["finished"], found["failed"]) == (0, 1, 1, [])
    assert "debug/gc_pmpc_plus/0: gc_pmpc_plus on reach, seed 0, 1 episodes:" in said
    rows = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    assert [(row["task"], row["method"], row["episode"], row["goals"]) for row in rows] == [
        ("reach", "gc_pmpc_plus", *point) for point in ((0, 1), (1, 1), (1, 2))
    ]
    assert sweep.state(sweep.runs_of(parsed(tmp_path, group()))[0]) == "debug/gc_pmpc_plus/0 1/1"
    code, found, said = command([group(final_goals=2), group(name="other")], "--dry-run")
    assert (code, found["runs"], found["finished"]) == (0, 2, 1)
    assert "2 runs, 1 to do" in said and "debug/other/0: to do" in said
    code, found, said = command([group(final_goals=3)], "--dry-run")  # the evaluation is still to do
    assert found["finished"] == 0 and "debug/gc_pmpc_plus/0: to do" in said


def test_single_runs_can_be_named(tmp_path, command):
    groups = [group(seeds=[1, 11]), group(name="other")]
    _, _, said = command(groups, "--dry-run", "--only", "debug/gc_pmpc_plus/1", "--only", "debug/other")
    assert [line for line in said.splitlines() if line.endswith("to do")] == [
        "2 runs, 2 to do",
        "debug/gc_pmpc_plus/1: to do",
        "debug/other/0: to do",
    ]
    with pytest.raises(ConfigError, match="--only egg: no such run"):
        sweep.chosen(sweep.runs_of(parsed(tmp_path, *groups)), ["egg"])


@dataclass(frozen=True)
class Killed(sweep.Run):
    """A run whose process is killed as soon as it begins."""

    def cell(self):
        os.kill(os.getpid(), signal.SIGKILL)


def test_a_run_that_is_killed_or_fails_leaves_the_others_alone(tmp_path):
    good, bad = sweep.runs_of(parsed(tmp_path, group(), group(name="bad")))
    bad.directory.mkdir(parents=True)
    (bad.directory / "curriculum.json").write_text("{}")
    killed = Killed("debug", "gc_pmpc_plus", 0, (), tmp_path / "out" / "debug" / "killed" / "0")
    said = {run.name: outcome for run, outcome in sweep.on_this_machine([killed, bad, good], 1)}
    assert said["debug/killed/0"].startswith("FAILED: BrokenProcessPool")
    assert said["debug/bad/0"].startswith("FAILED: ConfigError: ")
    assert "curriculum.json: cannot be read" in (bad.directory / "output.txt").read_text()
    assert sweep.finished(good)


def test_the_same_file_runs_through_submitit_and_a_failure_stays_alone(tmp_path, command):
    pytest.importorskip("submitit")
    (tmp_path / "out" / "debug" / "blocked").mkdir(parents=True)
    (tmp_path / "out" / "debug" / "blocked" / "0").write_text("a file where a folder should be")
    code, found, said = command([group(name="blocked"), group()], "--cluster", "local")
    assert (code, found["finished"], found["failed"]) == (1, 1, ["debug/blocked/0"])
    assert "debug/blocked/0: FAILED" in said and "seed 0, 1 episodes" in said


@pytest.mark.parametrize("file", SWEEPS, ids=lambda file: file.stem)
def test_the_sweeps_that_are_shipped_are_sound(file):
    runs = sweep.runs_of(load(sweep.Sweep, file))
    assert all(run.final_goals == 100 for run in runs)

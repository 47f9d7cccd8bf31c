"""A compared method in the whole cell: the rows, warm-up and resumption of every other run."""

import json
import sys

import pytest

from bench import evaluate as evaluation
from bench import run as bench_run
from bench.agents import AgentCell
from bench.baselines import td7
from bench.lockstep_run import Stalled, assemble
from bench.methods import configure
from bench.run import train
from common.config import ConfigError
from deploy.curriculum_files import read_rows

TINY = (
    "warmup_steps=100",
    "curriculum.warmup=mix",
    "curriculum.episode_steps=20",
    "curriculum.episodes=3",
    "curriculum.evaluate_every=2",
    "curriculum.evaluate_goals=1",
)
SMALL = ("agent.hidden=32", "agent.embedding=16", "agent.batch=16", "agent.target_update_every=10")
TIMES = ("t_ns", "duration_s")


def tiny(directory, *overrides, method="td7"):
    return configure("debug", method, (*TINY, *SMALL, *overrides), directory)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("run")
    summary = train(tiny(directory), "td7", directory)
    return directory, summary


def without(rows, names):
    return [{name: value for name, value in row.items() if name not in names} for row in rows]


def test_a_run_has_the_phases_of_every_run(finished):
    directory, summary = finished
    rows = read_rows(directory)
    assert [row["mode"] for row in rows] == [
        *["random"] * 5,
        "evaluate",
        "plan",
        "plan",
        "evaluate",
        "plan",
        "evaluate",
    ]
    assert (summary["method"], summary["training_episodes"]) == ("td7", 3)
    assert [row["snapshot_id"] for row in rows[5:]] == [f"td7-{n}" for n in (100, 100, 120, 140, 140, 160)]


def test_every_action_is_decided_on_the_state_that_it_acts_in(finished):
    rows = [row for row in read_rows(finished[0]) if row["mode"] != "random"]
    assert {(row["planned"], row["late"], row["held"]) for row in rows} == {(20, 0, 0)}


def test_warm_up_files_and_columns_are_those_of_the_paper_s_method(finished, tmp_path):
    ours = configure("debug", "gc_pmpc_plus", (*TINY, "model.targets=standardised"), tmp_path)
    run = assemble(ours, labels={"method": "gc_pmpc_plus"})
    run.lockstep.run(lambda: run.services["curriculum"].report().fields["episode"] >= 7, 2**62)
    files = [sorted((d / "learner" / "episodes").glob("*"))[:5] for d in (tmp_path, finished[0])]
    assert [file.name for file in files[0]] == [file.name for file in files[1]]
    for theirs, mine in zip(*files, strict=True):
        assert theirs.read_bytes() == mine.read_bytes()
    pairs = list(zip(read_rows(tmp_path), read_rows(finished[0]), strict=False))
    assert pairs[5][0]["mode"] == "evaluate"
    for theirs, mine in pairs:
        assert theirs.keys() == mine.keys()
        assert [theirs[name] for name in ("mode", "episode_seed", "trained_episodes")] == [
            mine[name] for name in ("mode", "episode_seed", "trained_episodes")
        ]


@pytest.mark.parametrize("killed_in", [4, 6, 8])
def test_an_interrupted_run_comes_to_the_same_result(finished, tmp_path, killed_in):
    directory, _ = finished
    run = assemble(tiny(tmp_path), labels={"method": "td7"})
    report = run.services["curriculum"].report
    run.lockstep.run(lambda: report().fields["episode"] >= killed_in, 2**62)  # and closes nothing, as a kill
    train(tiny(tmp_path), "td7", tmp_path)
    assert without(read_rows(tmp_path), TIMES) == without(read_rows(directory), TIMES)


def test_more_episodes_go_on_from_the_checkpoint(finished, tmp_path):
    directory, _ = finished
    train(tiny(tmp_path, "curriculum.episodes=1"), "td7", tmp_path)
    train(tiny(tmp_path), "td7", tmp_path)
    last = [without(read_rows(d), (*TIMES, "config_hash", "episode"))[-1] for d in (tmp_path, directory)]
    assert last[0] == last[1]


def test_evaluation_acts_with_what_was_learned_last(finished):
    directory, _ = finished
    cell = evaluation.configuration(directory, 2, 1_000_000, [])
    assert isinstance(cell, AgentCell)
    model = evaluation.load_model(cell, directory)
    rows = evaluation.evaluate(cell, model)
    assert [row["episode_seed"] for row in rows] == [1_000_000, 1_000_001]
    assert {row["snapshot_id"] for row in rows} == {"td7-160"}
    assert rows[0]["return"] == read_rows(directory)[-1]["return"]
    found = evaluation.result(cell, model, rows, 1.0)
    assert (found["episodes_seen"], found["agent"]["hidden"]) == (8, 32)
    json.dumps(found)


def test_a_checkpoint_of_other_settings_is_refused(finished):
    directory, _ = finished
    with pytest.raises(ConfigError, match="another configuration"):
        train(tiny(directory, "agent.hidden=16"), "td7", directory)
    with pytest.raises(ConfigError, match="belongs to another task, method, seed or setting"):
        assemble(tiny(directory, "agent.hidden=16"))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("agent.hiden=16", "debug.yaml: agent: hiden: no such key (given: 16)"),
        ("agent.batch=many", "debug.yaml: agent: batch: input should be a valid integer"),
    ],
)
def test_mistakes_in_a_method_s_settings_are_one_line(tmp_path, change, line):
    with pytest.raises(ConfigError) as error:
        tiny(tmp_path, change)
    assert error.value.lines[0].startswith(line.split(" (given")[0])


def test_without_the_extra_the_command_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "bench.baselines.sac", raising=False)
    monkeypatch.delitem(sys.modules, "bench.baselines.stable", raising=False)
    monkeypatch.setattr(
        sys, "argv", ["run", "--method", "sac", "--task", "reach", "--out", str(tmp_path / "x")]
    )
    with pytest.raises(SystemExit) as left:
        bench_run.main()
    assert left.value.code == (
        "bench.run: sac needs stable_baselines3: install the extra with `pip install -e .[baselines]`"
    )


def test_an_agent_that_fails_ends_the_run_and_says_why(tmp_path, monkeypatch):

    def broken(*_arguments):
        raise ValueError("no such weights")

    monkeypatch.setattr(td7.Agent, "learn", broken)
    with pytest.raises(Stalled, match="agent: learn failed: ValueError: no such weights"):
        train(tiny(tmp_path), "td7", tmp_path)

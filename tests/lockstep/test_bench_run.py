"""The whole cell in lock-step with tiny networks: deterministic, resumable, free of bus and viewer."""

import json
import subprocess
import sys
from contextlib import nullcontext

import numpy as np
import pytest
import yaml

from bench import evaluate as evaluation
from bench.case_study import study_of
from bench.lockstep_run import assemble
from bench.methods import configure
from bench.result_rows import final_row, keep_evaluation
from bench.run import _claim, train
from common.buslog import log_files
from common.config import ConfigError
from deploy.curriculum_files import read_rows
from services.sim.plant import ShadowHandPlant

# Enough random motion for a model that does not diverge, and no more.
TINY = (
    "warmup_steps=300",
    "model.targets=standardised",
    "learner.warmup_updates=100",
    "curriculum.warmup=mix",
    "curriculum.episode_steps=20",
    "curriculum.episodes=2",
    "curriculum.evaluate_every=2",
    "curriculum.evaluate_goals=1",
)
TIMES_AND_NAMES = ("t_ns", "duration_s", "snapshot_id")
FORBIDDEN = ("zenoh", "rerun", "cv2", "can", "stable_baselines3")


def tiny(directory, *overrides):
    return configure("debug", "gc_pmpc_plus", (*TINY, *overrides), directory)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("run")
    summary = train(tiny(directory), "gc_pmpc_plus", directory, log=True)
    return directory, summary


def without(rows, names):
    return [{name: value for name, value in row.items() if name not in names} for row in rows]


def test_a_run_leaves_rows_a_model_and_a_summary(finished):
    directory, summary = finished
    modes = [row["mode"] for row in read_rows(directory)]
    assert modes == [*["random"] * 15, "evaluate", "plan", "plan", "evaluate"]
    assert summary["training_episodes"] == 2 and summary["evaluation"]["goals"] == 1
    assert (directory / "learner" / "snapshot.safetensors").exists()
    assert json.loads((directory / "summary.json").read_text()) == summary
    results = [json.loads(line) for line in (directory / "results.jsonl").read_text().splitlines()]
    assert [(row["episode"], row["goals"]) for row in results] == [(0, 1), (2, 1)]
    assert all(summary["training_cost"]["cpu_s"][kind] > 0 for kind in ("train", "simulate"))


def test_the_same_seed_gives_the_same_bytes(finished, tmp_path):
    directory, _ = finished
    train(tiny(tmp_path), "gc_pmpc_plus", tmp_path, log=True)
    assert (tmp_path / "episodes.jsonl").read_bytes() == (directory / "episodes.jsonl").read_bytes()
    logs, others = log_files(tmp_path / "log" / "000"), log_files(directory / "log" / "000")
    assert len(logs) == 4
    assert [log.name for log in logs] == [log.name for log in others]
    for log, other in zip(logs, others, strict=True):
        assert log.read_bytes() == other.read_bytes(), log.name


@pytest.mark.parametrize("killed_in", [3, 16, 17, 18])
def test_an_interrupted_run_comes_to_the_same_result(finished, tmp_path, killed_in):
    directory, _ = finished
    run = assemble(tiny(tmp_path), labels={"method": "gc_pmpc_plus"})
    report = run.services["curriculum"].report
    run.lockstep.run(lambda: report().fields["episode"] >= killed_in, 2**62)  # and closes nothing, as a kill
    train(tiny(tmp_path), "gc_pmpc_plus", tmp_path)
    assert without(read_rows(tmp_path), TIMES_AND_NAMES) == without(read_rows(directory), TIMES_AND_NAMES)


def test_a_run_with_another_configuration_is_refused(finished):
    directory, _ = finished
    with pytest.raises(ConfigError, match="another configuration"):
        train(tiny(directory, "planner.horizon=6"), "gc_pmpc_plus", directory)


@pytest.mark.parametrize(("was", "same"), [({}, True), ({"hold_steps": 7}, False), ({"gone": 1}, False)])
def test_an_option_that_is_newer_than_the_run_had_its_default(tmp_path, was, same):
    cell = tiny(tmp_path)
    before = cell.model_dump(mode="json")
    del before["control"]["hold_steps"]
    before["control"] |= was
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(before))
    with nullcontext() if same else pytest.raises(ConfigError, match="another configuration"):
        _claim(cell, tmp_path)
    assert (yaml.safe_load((tmp_path / "config.yaml").read_text()) != before) is same


def test_evaluation_runs_the_newest_model_on_held_out_goals(finished):
    directory, _ = finished
    cell = evaluation.configuration(directory, 2, 1_000_000, [])
    snapshot = evaluation.load_snapshot(directory)
    rows = evaluation.evaluate(cell, snapshot)
    assert [row["episode_seed"] for row in rows] == [1_000_000, 1_000_001]
    assert {row["snapshot_id"] for row in rows} == {snapshot.id}
    last = read_rows(directory)[-1]
    assert last["snapshot_id"] == snapshot.id
    found = evaluation.result(cell, snapshot, rows, 1.0)
    assert found["goals"] == 2 and found["success_paper"]["wilson_95"]
    json.dumps(found)
    keep_evaluation(directory, rows, "abc")
    row = final_row(directory)
    assert (row["method"], row["seed"], row["episode"], row["goals"]) == ("gc_pmpc_plus", 0, 2, 2)
    assert row["mean_finger_error_mm"] == pytest.approx(1e3 * found["error_mean_finger_m"]["mean"], abs=1e-3)


def test_a_case_study_has_every_state_of_its_episodes(finished):
    directory, _ = finished
    task, study = study_of([directory], 2, 1_000_000)
    episodes = study["GC-PMPC+ (ours)"]
    cell = evaluation.configuration(directory, 2, 1_000_000, [])
    rows = evaluation.evaluate(cell, evaluation.load_snapshot(directory))
    for seed, episode, row in zip((1_000_000, 1_000_001), episodes, rows, strict=True):
        start = ShadowHandPlant("reach", seed)
        assert episode.states.shape == (21, 63)
        np.testing.assert_allclose(episode.states[0], start.state, atol=1e-6)
        np.testing.assert_allclose(episode.goal, start.goal, atol=1e-6)
        end = task.errors(episode.states[-1], episode.goal)["mean_finger_m"]
        assert float(end) == pytest.approx(row["error_mean_finger_m"], abs=1e-6)
    with pytest.raises(ConfigError, match="nowhere"):
        study_of([directory / "nowhere"], 2, 1_000_000)


@pytest.mark.parametrize("module", ["bench.run", "bench.evaluate", "bench.ceiling", "bench.sweep"])
def test_benches_import_neither_bus_nor_viewer_nor_devices(module):
    code = f"import sys, {module}; print(*[m for m in {FORBIDDEN} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == ""

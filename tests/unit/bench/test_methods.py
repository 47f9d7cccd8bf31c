import sys
from pathlib import Path

import pytest

from bench import run
from bench.agents import AGENTS, AgentCell
from bench.lockstep_run import Stalled
from bench.methods import METHODS, configure
from common.config import ConfigError


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("cell", ["reach", "egg_rotate"])
def test_every_method_is_a_configuration_of_its_own(cell, method):
    settings = configure(cell, method, [], Path("runs/x"))
    own = configure(cell, "gc_pmpc_plus", [], Path("runs/y"))
    same = ["gc_pmpc_plus", "no_dropout"]  # the cells have none already
    same += ["one_step", "no_correction"] * (cell == "egg_rotate")
    assert (settings.config_hash == own.config_hash) == (method in same)
    assert settings.control.synchronous == (method in ("dpets", "pets", "synchronous", *AGENTS))


def test_the_literal_method_takes_nothing_from_the_cell():
    settings = configure("reach", "gc_pmpc_paper", [], Path("runs/x"))
    assert (settings.planner.search, settings.planner.horizon, settings.planner.candidates) == (
        "cem",
        50,
        500,
    )
    assert settings.model.hidden == (512, 512, 512)
    assert (settings.control.start, settings.control.chunk) == ("zero", "x")


def test_overrides_win_over_the_method_and_mistakes_are_named():
    settings = configure("reach", "no_penalty", ["learner.loss.variance_penalty=3"], Path("runs/x"))
    assert settings.learner.loss.variance_penalty == 3
    with pytest.raises(ConfigError, match="no such method"):
        configure("reach", "ppo", [], Path("runs/x"))
    with pytest.raises(ConfigError, match=r"curriculum\.episods: no such key"):
        configure("reach", "gc_pmpc_plus", ["curriculum.episods=3"], Path("runs/x"))


def test_agents_decide_at_every_step_and_are_told_from_configurations():
    assert {name for name, method in METHODS.items() if method.agent} == set(AGENTS)
    for method in AGENTS:
        settings = configure("reach", method, ["agent.batch=7"], Path("runs/x"))
        assert isinstance(settings, AgentCell)
        assert (settings.agent_method, settings.agent["batch"]) == (method, 7)
        assert settings.control.steps_per_plan == 1


@pytest.mark.parametrize("cell", ["reach", "egg_rotate", "die"])
def test_x4_looks_beyond_the_steps_under_way(cell):
    settings = configure(cell, "x4", [], Path("runs/x"))
    assert (settings.control.steps_per_plan, settings.planner.horizon) == (4, 8)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (
            ["model.hidden=[64,64]"],
            "reach.yaml: learner.loss.decay: 3 values wanted, one per layer of model.hidden",
        ),
        (["planner.horizon=2"], "reach.yaml: planner.horizon (2) must exceed control.steps_per_plan (2)"),
        (["planner.members=6"], "reach.yaml: planner.members (6) exceed model.members (5)"),
    ],
)
def test_sections_that_contradict_each_other_are_refused_as_they_are_live(overrides, line):
    with pytest.raises(ConfigError) as error:
        configure("reach", "gc_pmpc_plus", overrides, Path("runs/x"))
    assert error.value.lines == [line]


def test_a_cell_has_its_base_here_too():
    settings = configure("egg_rotate", "gc_pmpc_plus", [], Path("runs/x"))
    assert (settings.task, settings.planner.horizon, settings.model.members) == ("egg_rotate", 16, 3)


def test_the_command_ends_a_mistake_in_one_line(tmp_path, monkeypatch):
    command = ["run", "--set", "model.hidden=[64,64]", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as left:
        run.main()
    assert left.value.code == (
        "bench.run: reach.yaml: learner.loss.decay: 3 values wanted, one per layer of model.hidden"
    )
    assert not (tmp_path / "out").exists()


def test_a_run_is_taken_up_again_with_another_bound_of_its_logs_but_no_other_value(tmp_path, monkeypatch):
    def assembled(*_arguments, **_options):
        raise Stalled("assembled")

    monkeypatch.setattr(run, "assemble", assembled)
    for overrides in ([], ["log.keep_mb=9"]):
        with pytest.raises(Stalled, match="assembled"):
            run.train(configure("debug", "gc_pmpc_plus", overrides, tmp_path), "gc_pmpc_plus", tmp_path)
    with pytest.raises(ConfigError, match="another configuration"):
        run.train(configure("debug", "gc_pmpc_plus", ["seed=1"], tmp_path), "gc_pmpc_plus", tmp_path)

from pathlib import Path

import pytest

from bench.methods import METHODS, configure
from common.config import ConfigError


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("cell", ["reach", "egg_rotate"])
def test_every_method_is_a_configuration_of_its_own(cell, method):
    settings = configure(cell, method, [], Path("runs/x"))
    own = configure(cell, "gc_pmpc", [], Path("runs/y"))
    has_it_already = (cell, method) == ("reach", "no_dropout")
    assert (settings.config_hash == own.config_hash) == (method == "gc_pmpc" or has_it_already)
    assert settings.control.synchronous == (method in ("dpets", "pets", "synchronous"))


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
        configure("reach", "sac", [], Path("runs/x"))
    with pytest.raises(ConfigError, match=r"curriculum\.episods: no such key"):
        configure("reach", "gc_pmpc", ["curriculum.episods=3"], Path("runs/x"))

"""Presets expand to values that can be overridden one by one; nonsense is refused."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from services.planner.config import PlannerConfig


def test_the_defaults_are_the_papers():
    config = PlannerConfig()
    assert (config.members, config.masks, config.horizon) == (5, 4, 50)
    assert (config.candidates, config.elites, config.iterations, config.momentum) == (500, 50, 5, 0.1)
    assert config.init_std**2 == (1 - -1) ** 2 / 16
    assert config == PlannerConfig(preset="paper")


def test_a_preset_may_be_overridden_field_by_field():
    fast = PlannerConfig(preset="fast")
    changed = PlannerConfig(preset="fast", horizon=16)
    assert changed.horizon == 16
    assert changed.model_dump(exclude={"horizon"}) == fast.model_dump(exclude={"horizon"})


def test_what_was_expanded_reads_back_as_itself():
    fast = PlannerConfig(preset="fast")
    assert PlannerConfig.model_validate(fast.model_dump(mode="json")) == fast


@pytest.mark.parametrize(
    "values",
    [
        {"preset": "slow"},
        {"elites": 501},
        {"preset": "fast", "propagation": "sampled"},
        {"search": "none"},
        {"smooth_signs": "printed"},
    ],
)
def test_nonsense_is_refused(values):
    with pytest.raises(ValidationError):
        PlannerConfig(**values)

"""The processes of the loop bench, briefly: they come up, agree on the figures, leave nothing behind."""

from __future__ import annotations

import subprocess
import sys

import pytest

from bench.loop import Cell, LoopError, Settings, measure

pytestmark = pytest.mark.processes

STEPS = 100
SHORT = Settings(steps=STEPS, rate_hz=50.0)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen]:
    """Every child that the bench starts."""
    children: list[subprocess.Popen] = []
    real = subprocess.Popen

    def popen(*arguments, **options):
        children.append(real(*arguments, **options))
        return children[-1]

    monkeypatch.setattr("bench.loop.subprocess.Popen", popen)
    return children


def test_a_short_run_is_consistent_and_leaves_nothing_behind(started):
    result = measure(SHORT, learner=False)
    assert result["steps"] == STEPS
    assert 1 <= result["plans"] <= STEPS
    assert 0 <= result["late_steps"] + result["held_steps"] <= STEPS
    assert result["overhead_ms_p50"] <= result["overhead_ms_p99"] <= result["overhead_ms_max"]
    assert result["plan_age_ms_p50"] >= SHORT.solve_ms
    assert result["plan_ms_p50"] >= SHORT.solve_ms
    assert {"sim", "planner", "snapshots"} == set(result["loop_ms_p50_p99"])
    assert len(started) == 4  # and the router
    assert all(child.returncode == 0 for child in started)


def test_a_child_that_cannot_start_is_named_in_one_line(started, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(LoopError, match=r"^router ended with code 1: it said nothing$"), Cell(SHORT, False):
        pass
    assert all(child.returncode is not None for child in started)

import json

import numpy as np
import pytest

from bench.run_curves import draw_runs, evaluated, over_seeds, trained
from bench.summary import last_evaluation, result_line, result_of

ROW = {"task": "reach", "method": "gc_pmpc", "seed": 0, "steps": 50, "late": 0, "held": 0}


def row(mode, after, error_m=0.002, **changes):
    return {
        **ROW,
        "mode": mode,
        "trained_episodes": after,
        "return": -1.0,
        "error_mean_finger_m": error_m,
        "success_paper": error_m < 0.002,
        **changes,
    }


def run(offset_m=0.0):
    goals = [row("plan", n, 0.01 / (n + 1) + offset_m) for n in range(4)]
    held_out = [
        row("evaluate", n, e + offset_m) for n in (0, 4) for e in (0.010 - 0.002 * n, 0.012 - 0.002 * n)
    ]
    return [row("random", 0), *held_out[:2], *goals, *held_out[2:]]


def test_the_result_is_that_of_the_last_evaluation():
    rows = last_evaluation(run())
    found = result_of(rows)
    assert found["goals"] == 2
    assert found["error_mean_finger_m"]["mean"] == pytest.approx(0.003)
    assert found["success_paper"]["count"] == 0
    assert found["success_paper"]["wilson_95"][1] == pytest.approx(0.6576, abs=1e-3)
    assert "mean finger 3.0 mm" in result_line(found)
    assert result_line(result_of([])) == "no evaluation"


def test_curves_are_means_over_goals_and_seeds():
    curves = [evaluated(run(offset), lambda r: r["error_mean_finger_m"]) for offset in (0.0, 0.002)]
    x, mean, deviation = over_seeds(curves)
    np.testing.assert_array_equal(x, [0, 4])
    np.testing.assert_allclose(mean, [0.012, 0.004])
    np.testing.assert_allclose(deviation, [0.001, 0.001])
    assert trained(run()) == {1: -1.0, 2: -1.0, 3: -1.0, 4: -1.0}


def test_the_picture_is_small(tmp_path):
    for name, offset in (("a", 0.0), ("b", 0.002)):
        (tmp_path / name).mkdir()
        text = "".join(json.dumps(each) + "\n" for each in run(offset))
        (tmp_path / name / "episodes.jsonl").write_text(text)
    draw_runs([tmp_path / "a", tmp_path / "b"], tmp_path / "curve.png")
    assert 5_000 < (tmp_path / "curve.png").stat().st_size < 500_000

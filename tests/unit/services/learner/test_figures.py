"""What the learner tells of its updates: figures that can be sent, of episodes that were held out."""

import numpy as np
import pytest
from pydantic import ValidationError

from common.task import get_task
from common.topics import METRICS
from services.learner.build import LearnerProcess, build
from services.learner.config import LearnerConfig
from services.learner.evaluation import ModelErrors
from services.learner.replay import is_held_out
from services.learner.trainer import SliceMetrics
from services.learner.worker import Trained
from tests.samples import TASK
from tests.unit.services.learner.driver import Learner, trained


@pytest.fixture
def learner(tmp_path):
    return Learner(tmp_path)


@pytest.mark.parametrize("name", ["warmup_updates", "updates_per_episode"])
def test_updates_of_no_steps_are_refused(name):
    with pytest.raises(ValidationError, match="greater than or equal to 1"):
        LearnerConfig.model_validate({name: 0})


def test_an_update_without_a_single_window_still_tells_what_it_has_seen(tmp_path):
    learner = Learner(tmp_path, warmup_steps=2)
    for number in (0, 1):
        learner.record(number, length=1)
    learner.work_all()
    assert [(m.after_episode, m.episodes, m.updates) for m in learner.all(METRICS)] == [(1, 2, 0)]


def test_figures_that_are_not_finite_are_dropped_and_counted(learner):
    learner.record(0)
    learner.record(1)
    learner.work()
    learner.work()
    bad = {"good": 1.5, "bad": float("nan")}
    errors = ModelErrors({"a": float("inf"), "b": 2.0}, {"c": float("nan")}, {"d": 0.5})
    metrics = SliceMetrics(2, 1, 1e-3, 7.0, bad)
    value = Trained(metrics, 2, 0, 1, 2, 10, "abc", b"weights", errors)
    learner.finish(learner.queue.popleft(), value)
    _, told = (output.message for output in learner.turn())
    assert (told.loss, told.holdout, told.calibration) == ({"good": 1.5}, {"b": 2.0}, {"d": 0.5})
    fields = learner.fields
    assert (fields["nonfinite_figures"], fields["skipped_gradients"], fields["gradient_norm"]) == (3, 1, 7.0)
    assert all(np.isfinite(value) for value in fields.values())


def test_gradient_steps_not_taken_are_counted(learner):
    learner.record(0)
    learner.record(1)
    learner.worker._trainer.dynamics.ensemble.max_log_var.data[0] = float("nan")
    learner.work_all()
    assert (learner.fields["skipped_gradients"], learner.fields["gradient_norm"]) == (3, 0.0)
    assert [m.after_episode for m in learner.all(METRICS)] == [1]
    assert learner.fields["nonfinite_figures"] > 0


def test_errors_are_told_of_held_out_episodes_only(tmp_path):
    assert LearnerConfig().holdout == 0.05
    assert [is_held_out(number, 0.4) for number in (0, 1, 2)] == [False, True, False]
    for holdout, expected in ((0.0, set()), (0.4, {f"{g.name}_h{h}" for g in TASK.groups for h in (1, 5)})):
        learner = trained(Learner(tmp_path / str(holdout), holdout=holdout))
        (metrics,) = learner.all(METRICS)
        assert set(metrics.holdout) == expected
        assert bool(metrics.calibration) == bool(expected)


def test_the_process_aligns_the_quaternions_of_its_task(tmp_path):
    model = {"members": 1, "hidden": [4], "train_masks": 1, "plan_masks": 1}
    section = {"loss": {"decay": [0.0, 0.0]}}
    for name, expected in (("reach", 0), ("die", 1)):
        data = {"task": name, "run_dir": tmp_path / name, "model": model, "learner": section}
        service = build(LearnerProcess.model_validate(data), 33).service
        parts = tuple(group.slice for group in get_task(name).groups if group.kind == "quaternion")
        assert len(parts) == expected
        assert service._worker._store.replay._coordinates.quaternions == parts

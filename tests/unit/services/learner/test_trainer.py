"""Training finds a known system with honest deviations, repeats itself, and resumes to the bit."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from common.model.config import ModelConfig
from common.model.ensemble import Ensemble
from common.model.snapshot import Snapshot, SnapshotRefused
from common.task import get_task
from services.learner.config import LearnerConfig, LossConfig
from services.learner.episode import Episode
from services.learner.loss import loss_terms
from services.learner.replay import Replay
from services.learner.trainer import Trainer, TrainerStateRefused
from tests.unit.services.learner.toy import (
    A_MATRIX,
    B_MATRIX,
    NOISE,
    SMALL,
    Layout,
    linear_replay,
)

NO_DECAY = (0.0, 0.0, 0.0)
QUIET = LossConfig(decay=NO_DECAY, variance_penalty=0.0)
CONFIG = LearnerConfig(loss=QUIET, learning_rate=3e-3, schedule="cosine", batch=128)


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def trainer(config=CONFIG, model=SMALL, seed=0):
    return Trainer(config, model, Layout(), seed)


def trained(config=CONFIG, updates=800, replay=None, model=SMALL):
    made, replay = trainer(config, model), replay or linear_replay()
    made.begin(replay, updates)
    made.train_slice(replay, updates)
    return made


def test_a_linear_gaussian_system_is_learned_with_calibrated_deviation():
    # One-step loss: the second step feeds a noisy prediction, whose own error it must account for.
    config = CONFIG.model_copy(update={"loss": QUIET.model_copy(update={"second_step": False})})
    replay = linear_replay(150, holdout=0.2)
    made = trained(config, 1200, replay)
    errors = made.evaluate_holdout(replay)
    rng = np.random.default_rng(1)
    state, action = rng.normal(size=(200, 3)) * 0.5, rng.uniform(-1, 1, (200, 2))
    expected = state @ A_MATRIX.T + action @ B_MATRIX.T
    prediction = made.dynamics.predict(
        torch.tensor(state, dtype=torch.float32).expand(2, -1, -1),
        torch.tensor(action, dtype=torch.float32).expand(2, -1, -1),
    )
    mean = prediction.next_state_mean.detach().mean(dim=0).numpy()
    deviation = prediction.variance.detach().mean(dim=(0, 1)).sqrt().numpy()
    assert (np.sqrt(((mean - expected) ** 2).mean(axis=0)) < 0.4 * NOISE).all()
    np.testing.assert_allclose(deviation, NOISE, rtol=0.1)
    for group in ("first", "second"):
        assert errors.calibration[group] == pytest.approx(1.0, abs=0.1)
        assert errors.coverage[f"{group}_1s"] == pytest.approx(0.683, abs=0.05)
        assert errors.coverage[f"{group}_2s"] == pytest.approx(0.954, abs=0.03)
    assert set(errors.errors) == {f"{group}_h{h}" for group in ("first", "second") for h in (1, 5, 10)}
    assert errors.errors["second_h1"] == pytest.approx(NOISE[2], rel=0.15)


def test_the_penalty_lowers_predicted_variance():
    def variance(penalty):
        loss = QUIET.model_copy(update={"variance_penalty": penalty, "penalty_units": "standardised"})
        made = trained(CONFIG.model_copy(update={"loss": loss}), 300)
        runs = linear_replay(5).trajectories(1, "train")
        prediction = made.dynamics.predict(
            runs.states[:, 0].expand(2, -1, -1), runs.actions[:, 0].expand(2, -1, -1)
        )
        return float(prediction.variance.detach().mean())

    assert variance(30.0) < 0.7 * variance(0.0)


def test_two_runs_are_equal():
    assert trained(updates=30).snapshot(1).to_bytes() == trained(updates=30).snapshot(1).to_bytes()


def test_slices_do_not_change_the_result():
    replay, made = linear_replay(), trainer()
    made.begin(replay, 30)
    while made.remaining:
        made.train_slice(replay, 7)
    assert made.snapshot(1).digest == trained(updates=30).snapshot(1).digest
    assert made.updates == 30


def test_resuming_equals_not_stopping(tmp_path):
    dropout = SMALL.model_copy(update={"dropout": 0.2})
    replay = linear_replay()
    straight = trained(updates=30, replay=replay, model=dropout)
    first = trainer(model=dropout)
    first.begin(replay, 30)
    first.train_slice(replay, 13)
    first.save(tmp_path / "state")
    second = trainer(model=dropout)
    second.load(tmp_path / "state")
    assert (second.remaining, second.updates) == (17, 13)
    second.train_slice(replay, 17)
    assert second.state_bytes() == straight.state_bytes()
    assert second.snapshot(1).to_bytes() == straight.snapshot(1).to_bytes()


def test_a_foreign_or_broken_state_is_refused_and_changes_nothing():
    made = trainer()
    before = made.state_bytes()
    with pytest.raises(TrainerStateRefused, match="saved by another"):
        made.load_state_bytes(trainer(seed=1).state_bytes())
    with pytest.raises(TrainerStateRefused, match="not a sealed"):
        made.load_state_bytes(before[:100])
    assert made.state_bytes() == before


def test_the_normaliser_follows_the_data_or_stays_frozen():
    def means(refit):
        made = trainer(CONFIG.model_copy(update={"normaliser_refit": refit}))
        made.begin(linear_replay(2), 1)
        first = made.dynamics.normaliser.input_mean.clone()
        made.begin(linear_replay(9), 1)
        return first, made.dynamics.normaliser.input_mean

    assert not torch.equal(*means("each_update"))
    assert torch.equal(*means("after_warmup"))
    assert torch.equal(means("each_update")[1], linear_replay(9).normaliser().input_mean)


def test_without_normalisation_inputs_stay_raw():
    made = trained(updates=1, model=SMALL.model_copy(update={"normalise": False}))
    assert torch.equal(made.dynamics.normaliser.input_std, torch.ones(5))


def test_no_data_means_nothing_to_do():
    made = trainer()
    made.begin(linear_replay(0), 100)
    assert made.remaining == 0
    assert made.train_slice(linear_replay(0)).updates == 0


def test_cosine_starts_at_the_rate_and_nears_zero():
    replay, made = linear_replay(), trainer()
    made.begin(replay, 10)
    rates = [made.train_slice(replay, 1).learning_rate for _ in range(10)]
    assert rates[0] == CONFIG.learning_rate
    assert rates[5] == pytest.approx(CONFIG.learning_rate / 2)
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] < 0.03 * CONFIG.learning_rate


def test_a_gradient_that_is_not_finite_is_skipped():
    replay, made = linear_replay(), trainer()
    made.begin(replay, 2)
    with torch.no_grad():
        made.dynamics.ensemble.max_log_var[0] = float("nan")
    before = made.dynamics.ensemble.weights[0].clone()
    metrics = made.train_slice(replay, 2)
    assert (metrics.updates, metrics.skipped, metrics.gradient_norm) == (2, 2, 0.0)
    assert torch.equal(made.dynamics.ensemble.weights[0], before)


def test_clipping_shortens_the_gradient():
    replay, made = linear_replay(), trainer(CONFIG.model_copy(update={"clip": 1e-3}))
    made.begin(replay, 1)
    assert made.train_slice(replay, 1).gradient_norm > 1e-3
    squares = sum(float(p.grad.square().sum()) for p in made.dynamics.ensemble.parameters())
    assert squares**0.5 == pytest.approx(1e-3, rel=1e-4)


@pytest.mark.parametrize("biases", [True, False])
def test_a_step_is_adam_on_the_whole_of_equation_4(biases):
    loss = LossConfig(decay=(0.3, 0.2, 0.1), decay_biases=biases)
    replay, made = linear_replay(), trainer(CONFIG.model_copy(update={"loss": loss, "clip": 1e9}))
    made.begin(replay, 1)
    windows = replay.sample(2, 128, _copied(made._generator))
    ensemble = Ensemble(*_copied_parameters(made.dynamics.ensemble))
    terms = loss_terms(replace(made.dynamics, ensemble=ensemble), windows, (None, None), loss)
    decay = sum(
        rate * (w.square().sum() + (b.square().sum() if biases else 0.0))
        for rate, w, b in zip(loss.decay, ensemble.weights, ensemble.biases, strict=True)
    )
    (terms.total + decay).backward()
    torch.optim.Adam(ensemble.parameters(), lr=3e-3).step()
    made.train_slice(replay, 1)
    for ours, expected in zip(made.dynamics.ensemble.parameters(), ensemble.parameters(), strict=True):
        torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-5)


def _copied(generator):
    copy = torch.Generator()
    copy.set_state(generator.get_state())
    return copy


def _copied_parameters(ensemble):
    groups = (ensemble.weights, ensemble.biases)
    lists = [[tensor.detach().clone() for tensor in group] for group in groups]
    return *lists, ensemble.max_log_var.detach().clone(), ensemble.min_log_var.detach().clone()


def test_training_and_planning_masks_come_from_different_pools():
    made = trainer(model=SMALL.model_copy(update={"dropout": 0.5}))
    training = {tuple(row.tolist()) for row in made._train_masks.layers[0].flatten(0, 1)}
    planning = {tuple(row.tolist()) for row in made.plan_masks.layers[0].flatten(0, 1)}
    assert not training & planning


def test_the_snapshot_predicts_what_the_trainer_predicts():
    made = trained(updates=5)
    read = Snapshot.from_bytes(made.snapshot(3).to_bytes()).dynamics(Layout())
    generator = torch.Generator().manual_seed(0)
    state, action = (torch.randn(2, 4, n, generator=generator) for n in (3, 2))
    torch.testing.assert_close(
        read.predict(state, action).next_state_mean, made.dynamics.predict(state, action).next_state_mean
    )


def test_configuration_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"loss\.decay needs 3 rates"):
        trainer(LearnerConfig())
    weighted = QUIET.model_copy(update={"group_weights": {"third": 2.0}})
    with pytest.raises(ValueError, match="toy has no group third"):
        trainer(CONFIG.model_copy(update={"loss": weighted}))


def test_defaults_are_the_papers():
    assert (ModelConfig().members, ModelConfig().hidden) == (5, (512, 512, 512))
    assert LossConfig().variance_penalty == 30.0


def test_object_coordinates_learn_and_weigh_their_own_numbers():
    task = get_task("egg_rotate")
    model = SMALL.model_copy(update={"coordinates": "contact", "targets": "standardised"})
    loss = QUIET.model_copy(update={"group_weights": {"object_rotation": 3.0}})
    made = Trainer(CONFIG.model_copy(update={"loss": loss}), model, task, 0)
    replay = Replay(task.state_dim, task.action_dim, 0.4, made.dynamics.coordinates)
    draw = np.random.default_rng(0)
    for number in range(3):
        states = draw.normal(0.0, 0.1, (21, 61)).astype(np.float32)
        states[:, 54:57] += (1.0, 0.87, 0.17)
        states[:, 57] = 1.0
        actions = draw.uniform(-1, 1, (20, 20)).astype(np.float32)
        replay.add(Episode(1, number, "random", states, actions, np.zeros(7, np.float32), np.ones(21, bool)))
    made.begin(replay, 2)
    assert math.isfinite(made.train_slice(replay, 2).loss["first_step"])
    found = made.evaluate_holdout(replay)
    assert found.errors.keys() == {f"{group.name}_h{h}" for group in task.groups for h in (1, 5, 10)}
    assert all(map(math.isfinite, (*found.errors.values(), *found.calibration.values())))
    assert made._weights.tolist() == [1.0] * 57 + [3.0] * 3
    assert made.dynamics.normaliser.input_mean.shape == (made.dynamics.coordinates.inputs,)
    read = Snapshot.from_bytes(made.snapshot(0).to_bytes()).dynamics(task)
    assert read.coordinates.inputs == made.dynamics.coordinates.inputs
    with pytest.raises(SnapshotRefused, match="made for task"):
        Snapshot.from_bytes(made.snapshot(0).to_bytes()).dynamics(get_task("block"))

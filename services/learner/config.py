"""The learner's options; the defaults are the paper's, or those of the code that it grew from."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from common.config import Frozen

NonNegative = Annotated[float, Field(ge=0.0)]


class LossConfig(Frozen):
    """Eq. (4): two-step likelihood, variance penalty and weight decay."""

    variance_penalty: float = Field(
        default=30.0, ge=0.0, description="Delta; with penalty_units: standardised about 30 / S suits better"
    )
    penalty_units: Literal["raw", "standardised"] = Field(
        default="raw",
        description="unit of the penalised variance: the state's own, or its change's deviation",
    )
    decay: tuple[NonNegative, ...] = Field(
        default=(0.5e-4, 1.25e-4, 1.25e-4, 2.5e-4),
        description="lambda_l of each layer; DPETS's 1e-4, 2.5e-4, 2.5e-4, 5e-4 halved, as its term is",
    )
    decay_biases: bool = Field(
        default=True, description="biases decay too, as the paper says; DPETS spares them"
    )
    bound_weight: float = Field(
        default=0.0005, ge=0.0, description="pulls the learned log-variance bounds together; PETS takes 0.01"
    )
    second_step: bool = Field(default=True, description="false: one-step likelihood, as PETS")
    teacher_forcing: bool = Field(
        default=False,
        description="feed the true second state to step 2 instead of the model's own prediction",
    )
    beta_nll: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="weigh each error by variance**beta; 0.5 suited contact-rich tasks",
    )
    target_bound: float = Field(
        default=0.0,
        ge=0.0,
        description="a change of more deviations than this counts as this many; 0: no bound. One drop may "
        "otherwise outweigh all other data",
    )
    group_weights: dict[str, NonNegative] = Field(
        default_factory=dict,
        description="weight of each state group in the likelihood, 1 when absent; reach gained from "
        "{qvel: 0.2, tips: 3.0}",
    )


class LearnerConfig(Frozen):
    """How the ensemble is trained between episodes."""

    loss: LossConfig = Field(default_factory=LossConfig)
    learning_rate: float = Field(
        default=1e-3, gt=0.0, description="Adam's in the first update, on the warm-up data"
    )
    later_learning_rate: float = Field(
        default=1e-3, gt=0.0, description="Adam's in the updates after the first one"
    )
    schedule: Literal["constant", "cosine"] = Field(
        default="constant", description="cosine: the rate falls to 0 over each update; suits reach"
    )
    clip: float = Field(
        default=20.0, gt=0.0, description="largest norm of the gradient of all members together"
    )
    batch: int = Field(
        default=256, ge=1, description="N, windows a member in each gradient step; DPETS takes 30"
    )
    warmup_updates: int = Field(
        default=1000, ge=1, description="gradient steps of the first update, on the warm-up data"
    )
    updates_per_episode: int = Field(
        default=100,
        ge=1,
        description="gradient steps after each episode; reach did with 40, 5 epochs are about 20 n",
    )
    slice_updates: int = Field(default=20, ge=1, description="gradient steps in one job")
    holdout: float = Field(
        default=0.05,
        ge=0.0,
        lt=1.0,
        description="share of episodes kept out of training; 0: no errors and no calibration are told",
    )
    recent_fraction: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="share of a batch drawn from recent episodes; 0.5 suits reach",
    )
    recent_episodes: int = Field(default=20, ge=1, description="how many of the newest episodes are recent")
    normaliser_refit: Literal["each_update", "after_warmup"] = Field(
        default="each_update", description="after_warmup: fitted once and then frozen; steadier for reach"
    )
    threads: int = Field(default=1, ge=1, description="CPU threads of the training job")
    device: str = Field(default="cpu", description="where training runs: cpu, cuda, cuda:1")
    declared_update_ms: float = Field(
        default=20.0, ge=0.0, description="duration of a gradient step in lock-step"
    )
    declared_store_ms: float = Field(default=5.0, ge=0.0, description="duration of storing an episode there")

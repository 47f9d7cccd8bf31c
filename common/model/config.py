"""Shape and statistics of the dynamics model; the defaults are the paper's, or its predecessor DPETS's."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from common.config import Frozen

CoordinatesName = Literal["raw", "object", "contact"]
Width = Annotated[int, Field(ge=1, le=65536)]


class ModelConfig(Frozen):
    """The probabilistic ensemble of Eq. (1) and Eq. (3): B networks, each with M Dropout particles."""

    members: int = Field(default=5, ge=1, le=1024, description="B, networks in the ensemble")
    hidden: tuple[Width, ...] = Field(
        default=(512, 512, 512), min_length=1, max_length=64, description="width of each hidden layer"
    )
    dropout: float = Field(
        default=0.05,
        ge=0.0,
        lt=1.0,
        description="probability of dropping a hidden unit; 0 turns the masks off",
    )
    train_masks: int = Field(default=5, ge=1, le=4096, description="masks a member in the pool for training")
    plan_masks: int = Field(default=5, ge=1, le=4096, description="masks a member in the pool for planning")
    log_var_max: float = Field(
        default=0.5, description="initial upper soft bound of the predicted log-variance"
    )
    log_var_min: float = Field(
        default=-10.0, description="initial lower soft bound of the predicted log-variance"
    )
    normalise: bool = Field(
        default=True, description="standardise inputs (the paper's BN, Eq. 3); false is the ablation"
    )
    coordinates: CoordinatesName = Field(
        default="raw",
        description="what networks take and give. raw: state and action as they are; object: motion in the "
        "world's frame, orientation up to the object's symmetry; contact: and where the hand touches it",
    )
    targets: Literal["raw", "standardised"] = Field(
        default="raw",
        description="unit of the state change that the networks predict. raw: the state's own, as DPETS; "
        "standardised: divided by its deviation, which learned better in all four simulated tasks",
    )

    @model_validator(mode="after")
    def _bounds_are_ordered(self) -> ModelConfig:
        if self.log_var_min >= self.log_var_max:
            raise ValueError("log_var_min must be below log_var_max")
        return self

    def layer_sizes(self, inputs: int, outputs: int) -> list[tuple[int, int]]:
        """(fan in, fan out) of each layer, for `inputs` features and `outputs` numbers of the head."""
        widths = [inputs, *self.hidden, outputs]
        return list(pairwise(widths))

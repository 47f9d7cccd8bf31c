"""The curriculum's section of a cell: how long to learn, on what, and how often to look at the result."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from common.cell import SharedConfig
from common.config import Frozen
from common.die import FACES

FIRST_EVALUATION_SEED = 1_000_000
Face = Annotated[int, Field(ge=1, le=FACES)]


class CurriculumConfig(Frozen):
    """Warm-up, training goals and evaluations. The number of warm-up steps is shared with the learner."""

    episodes: int = Field(
        default=100, ge=0, description="training episodes after the warm-up, a new goal in each"
    )
    episode_steps: int = Field(default=50, ge=1, le=100_000, description="control steps of every episode")
    goal_faces: tuple[Face, ...] = Field(
        default=(),
        description="die: faces to be brought up one after another, an equal share of `episodes` each; "
        "held-out goals take turns. Empty: each episode's seed decides",
    )
    warmup: Literal["uniform", "mix", "glove"] = Field(
        default="uniform",
        description="random actions: iid uniform (the paper's), or joints held for random durations, "
        "whose model predicts 2 to 3 times better near rest; or what glove.sources have recorded",
    )
    evaluate_every: int = Field(default=25, ge=1, description="training episodes between two evaluations")
    evaluate_goals: int = Field(
        default=10, ge=0, description="held-out goals of an evaluation; 0: no evaluations"
    )
    evaluation_seed: int = Field(
        default=FIRST_EVALUATION_SEED, ge=FIRST_EVALUATION_SEED, description="seed of the first held-out goal"
    )
    wait_for_update: bool = Field(
        default=True,
        description="the next goal waits for the update (the paper's way); false: learn while acting",
    )
    ack_timeout_s: float = Field(
        default=30.0, gt=0, description="an episode that the learner has not stored by then counts as lost"
    )


class CurriculumProcess(SharedConfig):
    """What the curriculum process is started with."""

    curriculum: CurriculumConfig = CurriculumConfig()

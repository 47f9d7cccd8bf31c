"""The planner's section of a cell: a preset names a set of values, any of which the YAML may override."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from common.config import Frozen

# `paper` is what the fields below default to. `fast` was chosen on reach, closed loop over 20 held-out goals
# with one trained model: two Gauss-Newton steps end at 2.4 mm mean finger error, six Adam steps on four
# sequences at 3.6 mm for three times the work. Differences under 0.3 mm are noise.
PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "paper": {},
        "fast": {
            "horizon": 4,
            "members": 3,
            "masks": 1,
            "knots": 1,
            # Paper: 0.01 on the real hand; in simulation that outweighs the reward of the last centimetre.
            "smooth_weight": 0.001,
            "search": "icem",
            "candidates": 40,
            "elites": 8,
            "iterations": 1,
            "init_std": 0.3,
            "refine": "gauss_newton",
            "refine_sequences": 1,
            "refine_steps": 2,
        },
    }
)


class PlannerConfig(Frozen):
    """How to plan. Defaults are the values of the paper, and of DPETS where the paper gives none."""

    preset: Literal["paper", "fast"] = Field(
        default="paper",
        description="values that the other keys default to: the paper's, or a real-time search",
    )

    # Particles: B members with M Dropout masks each.
    members: int = Field(default=5, ge=1, description="B, the members of the ensemble that are used")
    masks: int = Field(default=4, ge=1, description="M, the planning masks used of each member")
    propagation: Literal["particles", "average", "sampled"] = Field(
        default="particles",
        description="particles stay apart and follow means; are averaged at each step (Eq. (1) as printed); "
        "or stay apart and draw from each predicted Gaussian (PETS)",
    )

    # Horizon and shape of a candidate.
    horizon: int = Field(default=50, ge=1, description="H, steps; the paper's real hand uses 30")
    horizon_to_episode_end: bool = Field(
        default=False, description="never look beyond the episode's last step"
    )
    knots: int = Field(
        default=0, ge=0, description="K, free actions over the horizon; 1 = constant, 0 = one per step"
    )
    interpolation: Literal["linear", "hold"] = Field(
        default="linear", description="of the actions between knots"
    )

    # Objective, Eq. (5).
    smooth_weight: float = Field(default=0.01, ge=0.0, description="λ, reward per unit of summed |Δs|")
    smooth_groups: tuple[str, ...] = Field(
        default=("qpos", "object_position", "object_rotation"),
        description="state groups that are smoothed, in raw units; names that the task lacks are skipped",
    )
    smooth_sign: Literal["subtract", "printed"] = Field(
        default="subtract", description="`printed` adds the term"
    )
    stray_weight: float = Field(
        default=0.0,
        ge=0.0,
        description="reward lost a step per metre that an object strays from its place",
    )
    sink_weight: float = Field(
        default=0.0,
        ge=0.0,
        description="reward lost a step per metre that an object sinks out of the hand",
    )
    disagreement_weight: float = Field(
        default=0.0, ge=0.0, description="per unit of the return's std over particles"
    )
    tail_steps: float = Field(
        default=0.0,
        ge=0.0,
        description="further steps for which the last predicted reward stands; fewer as the episode ends",
    )

    # What the model has lately been wrong by.
    correction: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="share of the newest prediction error by which predictions are corrected within an "
        "episode; 0: none",
    )
    correction_groups: tuple[str, ...] = Field(
        default=("tips",),
        description="state groups that are corrected; names that the task lacks are skipped",
    )
    correction_bound: float = Field(
        default=0.04, gt=0.0, description="error that a step counts for at most, in deviations of the change"
    )
    correction_pace: float = Field(
        default=0.5, gt=0.0, description="how fast a step may be that counts, in such errors"
    )

    # Search over candidates.
    search: Literal["cem", "icem", "none"] = Field(
        default="cem",
        description="cem: the paper's; icem: coloured noise, kept elites; none: refinement alone",
    )
    candidates: int = Field(default=500, ge=1, description="N, in the first iteration")
    elites: int = Field(default=50, ge=1, description="best candidates that set mean and variance")
    iterations: int = Field(default=5, ge=1, description="rounds of sampling")
    momentum: float = Field(default=0.1, ge=0.0, lt=1.0, description="α, share of the old mean and variance")
    init_std: float = Field(
        default=0.5, gt=0.0, description="a quarter of the action range: variance (ub - lb)²/16"
    )
    min_variance: float = Field(default=1e-3, ge=0.0, description="CEM stops below it")
    noise_beta: float = Field(default=2.0, ge=0.0, description="iCEM: noise power falls as frequency^-β")
    population_decay: float = Field(
        default=1.25, ge=1.0, description="iCEM: candidates shrink by it each iteration"
    )
    keep_fraction: float = Field(
        default=0.3, ge=0.0, le=1.0, description="iCEM: share of the elites that is kept"
    )

    # Refinement of the best sequences through the model.
    refine: Literal["adam", "gauss_newton"] = Field(
        default="adam",
        description="adam: by the score's gradient; gauss_newton: by the reward's residuals, one sequence",
    )
    refine_sequences: int = Field(default=0, ge=0, description="sequences that are refined; 0: none")
    refine_steps: int = Field(default=0, ge=0, description="steps of refinement")
    refine_difference: float = Field(
        default=0.02, gt=0.0, le=1.0, description="Gauss-Newton's finite difference, in normalised action"
    )
    refine_rate: float = Field(
        default=0.08, gt=0.0, description="Adam's first step, in normalised action; falls to zero"
    )

    # Time and exploration; x and the start of an episode are the cell's `control` section.
    declared_solve_ms: float = Field(default=50.0, gt=0.0, description="how long a plan takes in lock-step")
    explore_std: float = Field(
        default=0.0, ge=0.0, description="noise added to the actions of exploring episodes"
    )
    explore_every: int = Field(default=2, ge=1, description="one training episode in so many explores")
    explore_redraw: float = Field(
        default=0.1, ge=0.0, le=1.0, description="a joint's chance per step of new noise"
    )

    threads: int = Field(default=1, ge=1, description="CPU threads of a plan")
    device: str = Field(default="cpu", description="where plans are made: cpu, cuda, cuda:1")

    @model_validator(mode="before")
    @classmethod
    def _expand_preset(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        return {**PRESETS.get(str(data.get("preset", "paper")), {}), **data}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.elites > self.candidates:
            raise ValueError(f"elites ({self.elites}) exceed candidates ({self.candidates})")
        if self.refines and self.propagation == "sampled":
            raise ValueError("refinement needs a deterministic model: propagation `sampled` has none")
        if self.search == "none" and not self.refines:
            raise ValueError("search `none` needs refine_sequences and refine_steps")
        if self.refines and self.refine == "gauss_newton" and self.refine_sequences != 1:
            raise ValueError(f"gauss_newton refines 1 sequence, not refine_sequences {self.refine_sequences}")
        return self

    @property
    def refines(self) -> bool:
        """Whether sequences are refined after the search."""
        return self.refine_sequences > 0 and self.refine_steps > 0

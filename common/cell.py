"""The sections of a cell that every process needs, whatever its service."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from common.bus_config import BusConfig
from common.config import Frozen


class ControlConfig(Frozen):
    """Timing of the control loop (Sec. III-B of the paper), shared by plant and planner."""

    rate_hz: float = Field(default=25.0, gt=0, le=1000, description="control frequency of the hand, ν_system")
    steps_per_plan: int | Literal["auto"] = Field(
        default=2, description="x: actions executed per plan; auto = ceil(ν_system · measured solve time)"
    )
    start: Literal["zero", "plan"] = Field(
        default="plan", description="zero: x zero actions first (the paper's); plan: wait for the first plan"
    )
    synchronous: bool = Field(
        default=False, description="ahead 0: the plant waits for each plan; lock-step only"
    )
    chunk: Literal["x", "horizon"] = Field(
        default="horizon",
        description="actions per chunk: x only, or the whole plan so that a late planner has a tail",
    )
    hold_steps: int = Field(
        default=25, ge=0, description="steps of repeating the last command before relaxing to zero"
    )

    @model_validator(mode="after")
    def _plausible(self) -> ControlConfig:
        if self.steps_per_plan != "auto" and not 1 <= self.steps_per_plan <= 50:
            raise ValueError("steps_per_plan must be auto or from 1 to 50")
        if self.steps_per_plan == "auto" and self.start == "zero":
            raise ValueError("start: zero executes x zero actions, so steps_per_plan must be a number")
        return self

    @property
    def period_ns(self) -> int:
        """Duration of one control step in ns."""
        return round(1e9 / self.rate_hz)


class LogConfig(Frozen):
    """Bounds of each process's bus log."""

    enabled: bool = Field(default=True, description="keep what each process received, decided and sent")
    segment_mb: float = Field(default=64.0, gt=0, description="size at which a new file is begun")
    keep_mb: float = Field(default=512.0, gt=0, description="oldest files beyond this total are deleted")


class SharedConfig(Frozen):
    """What each process of a cell knows: its name, task, bus, timing, and where to write."""

    cell: str = Field(default="reach", pattern=r"^[a-z][a-z0-9_]*$", description="key prefix on the bus")
    task: Literal["reach", "egg", "egg_rotate", "block", "die", "die_left"] = Field(
        default="reach", description="what the hand learns; it fixes state, action and goal"
    )
    seed: int = Field(
        default=0, ge=0, lt=1_000_000, description="training seed; evaluation seeds start at 1 000 000"
    )
    warmup_steps: int = Field(
        default=5000, ge=0, description="steps of the warm-up before the first training"
    )
    run_dir: Path = Field(default=Path("runs/reach"), description="where this run's results are kept")
    config_hash: str = Field(
        default="", description="digest of the whole cell; written by deploy, compared by doctor"
    )
    bus: BusConfig = BusConfig()
    control: ControlConfig = ControlConfig()
    log: LogConfig = LogConfig()

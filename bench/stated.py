"""What the comparison is about: methods in their order, the protocol, and what the paper states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

OURS = "gc_pmpc_plus"
TASKS = ("reach", "egg", "egg_rotate", "block")
SEEDS = (0, 1, 2)
WARMUP_STEPS, EPISODE_STEPS = 5000, 50
FINAL_GOALS = 100

# Label → what figures call it. All of them are expected on all tasks.
COMPARED: Mapping[str, str] = MappingProxyType(
    {
        OURS: "GC-PMPC+ (ours)",
        "gc_pmpc": "GC-PMPC",
        "dpets": "DPETS",
        "pets": "PETS",
        "tdmpc": "TD-MPC",
        "td7": "TD7",
        "sac": "SAC",
        "ddpg_her": "DDPG + HER",
    }
)
# Shown where they exist: the literal method, and model-free learning to 300 000 steps.
FURTHER: Mapping[str, str] = MappingProxyType(
    {"gc_pmpc_paper": "GC-PMPC, literal", "sac_long": "SAC, long", "td7_long": "TD7, long"}
)
ABLATIONS = (
    "no_normalisation",
    "no_penalty",
    "one_step",
    "no_smoothing",
    "no_correction",
    "printed_smoothing",
    "no_dropout",
    "synchronous",
    "x4",
    "average",
)
ABLATION_TASKS: Mapping[str, tuple[int, ...]] = MappingProxyType({"reach": SEEDS, "egg_rotate": (0,)})


@dataclass(frozen=True)
class Stated:
    """The paper's Sec. IV-B on one task; success rates in [0, 1], of GC-PMPC and of the best other method."""

    text: str
    success: float | None = None
    others: float | None = None


PAPER: Mapping[str, Stated] = MappingProxyType(
    {
        "reach": Stated(
            "mastered within 200 episodes, no figure given; no model-free method met the 2 mm, and they came "
            "near to GC-PMPC after about 500 000 steps"
        ),
        "egg": Stated("80 % after 100 episodes; the others showed virtually no signs of learning", 0.80),
        "egg_rotate": Stated("about 70 % after an hour; the others reached only 20 %", 0.70, 0.20),
        "block": Stated("more than double the others' success after an hour, no figure given"),
    }
)
# Return on reach that model-free learning is known to reach, after 1.5 million steps of PPO:
# https://github.com/j-mauro-r/reinforcement_learning_reto_2
RETURN_BAR = -0.78

"""SAC by stable-baselines3: Haarnoja et al., "Soft Actor-Critic Algorithms and Applications", 2018.

No published settings for these tasks exist. Discount, learning rate, τ and network are those of the nearest
entry of rl-baselines3-zoo, FetchPush (hyperparams/tqc.yml), which a public script for Shadow Hand block tasks
takes over unchanged (mshashank02/ShadowHand-TQC); everything else is stable-baselines3's default.

Deviations:
* Batch 256, stable-baselines3's default for SAC, in place of 2048, for the sake of a processor without
  accelerator. No hindsight relabelling: that is `ddpg_her`.
* 5000 warm-up steps of the bench and as many updates before the first own episode; then, as published, one
  update per step, taken after each episode of 50.
* Observations are standardised by the warm-up.
"""

from __future__ import annotations

from stable_baselines3 import SAC

from bench.baselines.stable import GoalSpaces, StableController, build, networks
from common.config import Frozen
from common.task import Task


class Config(Frozen):
    """Settings, of rl-baselines3-zoo unless said otherwise."""

    learning_rate: float = 1e-3
    discount: float = 0.95
    tau: float = 0.05
    hidden: tuple[int, ...] = (512, 512, 512)
    batch: int = 256  # stable-baselines3's
    entropy: str = "auto"  # stable-baselines3's: learned, towards an entropy of -A
    buffer: int = 400_000  # steps; more than any run here has


class Agent(StableController):
    """A `Controller`."""

    def __init__(self, config: Config, task: Task, seed: int) -> None:
        # --- the method ---
        def make(env: GoalSpaces) -> SAC:
            """The algorithm over the task's spaces; it never steps `env`."""
            return SAC(
                "MultiInputPolicy",
                env,
                learning_rate=config.learning_rate,
                gamma=config.discount,
                tau=config.tau,
                buffer_size=config.buffer,
                ent_coef=config.entropy,
                policy_kwargs=networks(config.hidden, task),
                device="cpu",
            )

        super().__init__(build(make, task, seed), task, config.batch)

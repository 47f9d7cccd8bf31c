"""Puts the learner together from its configuration and what is on disk."""

from __future__ import annotations

import torch

from common.built import Built
from common.cell import SharedConfig
from common.model.config import ModelConfig
from common.task import get_task
from services.learner.backprop import keep_freed_memory
from services.learner.config import LearnerConfig
from services.learner.dataset import EpisodeStore
from services.learner.service import LearnerService
from services.learner.trainer import Trainer
from services.learner.worker import LearnerWorker


class LearnerProcess(SharedConfig):
    """What the learner process is started with."""

    model: ModelConfig = ModelConfig()
    learner: LearnerConfig = LearnerConfig()


def build(config: LearnerProcess, boot_id: int) -> Built:
    """Make the service and the worker that holds replay and trainer."""
    torch.set_num_threads(config.learner.threads)
    keep_freed_memory()
    task = get_task(config.task)
    directory = config.run_dir / "learner"
    trainer = Trainer(config.learner, config.model, task, config.seed, config.learner.device)
    store = EpisodeStore(
        directory / "episodes",
        task.state_dim,
        task.action_dim,
        config.learner.holdout,
        trainer.dynamics.coordinates,
        lost=task.dropped,
    )
    worker = LearnerWorker(directory, store, trainer)
    return Built(LearnerService(config.learner, config.warmup_steps, worker, boot_id))

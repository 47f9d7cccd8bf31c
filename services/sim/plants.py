"""The simulated hand of a task."""

from __future__ import annotations

from common.task import DieTask, get_task
from services.sim.dexhand_physics import TwinPhysics
from services.sim.interface import Plant


def make_plant(task_name: str, rate_hz: float | None = None, physics: TwinPhysics | None = None) -> Plant:
    """Build the plant of the named task; `rate_hz` and `physics` are for the hand that has none of its own.

    Raises ValueError for an unknown task.
    """
    # Imported when needed: the environments of the one take seconds, and the other does without them.
    task = get_task(task_name)
    if isinstance(task, DieTask):
        from services.sim.dexhand_twin import DexHandTwin

        if rate_hz is None:
            return DexHandTwin(task.hand, physics=physics)
        return DexHandTwin(task.hand, rate_hz=rate_hz, physics=physics)
    from services.sim.plant import ShadowHandPlant

    return ShadowHandPlant(task_name)

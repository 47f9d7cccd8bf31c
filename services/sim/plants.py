"""The simulated hand of a task."""

from __future__ import annotations

from common.task import DieTask, get_task
from services.sim.interface import Plant


def make_plant(task_name: str, rate_hz: float | None = None) -> Plant:
    """Build the plant of the named task; `rate_hz` is for the hand that has no control rate of its own.

    Raises ValueError for an unknown task.
    """
    # Imported when needed: the environments of the one take seconds, and the other does without them.
    task = get_task(task_name)
    if isinstance(task, DieTask):
        from services.sim.dexhand_twin import DexHandTwin

        return DexHandTwin(task.hand) if rate_hz is None else DexHandTwin(task.hand, rate_hz=rate_hz)
    from services.sim.plant import ShadowHandPlant

    return ShadowHandPlant(task_name)

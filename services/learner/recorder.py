"""Turns `control/step` messages into whole episodes, whatever order or how often they arrive."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from common.messages import Header, Mode, Step
from services.learner.episode import Episode

PARTIAL_EPISODES = 4  # the running one, and a few that may still be completed by recovered messages


@dataclass
class _Partial:
    """Steps of one episode by k, as far as they have arrived."""

    steps: dict[int, Step] = field(default_factory=dict[int, Step])
    length: int = -1  # its last k, once known

    def complete(self) -> bool:
        return 0 <= self.length < len(self.steps) and all(k in self.steps for k in range(self.length + 1))


class Recorder:
    """Collects the steps of episodes that are to be learned from; duplicates are ignored."""

    def __init__(self) -> None:
        self._partial: dict[tuple[int, int], _Partial] = {}
        self._done: set[tuple[int, int]] = set()
        self.incomplete = 0  # episodes given up because steps were lost or the plant began another

    def add(self, header: Header, step: Step) -> Episode | None:
        """Take one step; returns the episode that it completes, if it does. Evaluations are passed over."""
        key = (header.boot_id, step.episode)
        if step.mode in (Mode.EVALUATE, Mode.IDLE) or step.waiting or key in self._done:
            return None
        partial = self._partial.setdefault(key, _Partial())
        partial.steps[step.k] = step
        if step.last:
            partial.length = step.k
        if partial.complete():
            del self._partial[key]
            self._done.add(key)
            if not partial.length:
                return None  # an episode of no steps: there is nothing to learn from it
            return _episode(header.boot_id, partial)
        self._forget_old()
        return None

    def _forget_old(self) -> None:
        while len(self._partial) > PARTIAL_EPISODES:
            del self._partial[next(iter(self._partial))]
            self.incomplete += 1


def _episode(boot_id: int, partial: _Partial) -> Episode:
    """States (T + 1, S) and the T actions between them; the goal is the one that it ended with."""
    steps = [partial.steps[k] for k in range(partial.length + 1)]
    return Episode(
        boot_id=boot_id,
        episode=steps[0].episode,
        mode=steps[0].mode.value,
        states=np.stack([step.state for step in steps]).astype(np.float32),
        actions=np.stack([step.prev_action for step in steps[1:]]).astype(np.float32),
        goal=steps[-1].goal.astype(np.float32),
        valid=np.array([bool(step.part_valid.all()) for step in steps]),
    )

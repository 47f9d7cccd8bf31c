"""The steps that the plant has executed since the last request: what predictions are held against."""

from __future__ import annotations

import numpy as np

from common.messages import Float32

_MOST_STEPS = 50


class Executed:
    """Consecutive measured states and the actions between them; a gap begins anew."""

    def __init__(self) -> None:
        self._newest_k = -1
        self._action_dim = 0
        self._states: list[Float32] = []
        self._actions: list[Float32] = []

    def add(self, k: int, prev_action: Float32, state: Float32 | None) -> None:
        """Take step k: its state (S,), None if it was not measured, and the action (A,) that led to it."""
        if k == self._newest_k:
            return
        if k != self._newest_k + 1 or state is None or len(self._actions) >= _MOST_STEPS:
            self._states, self._actions = [], []
        self._newest_k, self._action_dim = k, len(prev_action)
        if state is None:
            return
        if self._states:
            self._actions.append(prev_action)
        self._states.append(state)

    def take(self) -> tuple[Float32, Float32]:
        """States (T + 1, S) and actions (T, A) since the last call; the newest state stays for the next.

        There must be a state.
        """
        states = np.array(self._states, np.float32)
        actions = np.array(self._actions, np.float32).reshape(len(states) - 1, self._action_dim)
        self._states, self._actions = self._states[-1:], []
        return states, actions

"""Draws a DexHand for people: joint by joint what it was told and does, fingertips, boards, faults."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from common.dexhand021.angles import to_radians
from common.dexhand021.tables import JOINTS, Hand
from common.hand_messages import HandJoints
from common.messages import Step
from common.task import DieTask, Task
from deploy.viewer.drawing import Arrow, Drawing, State, When, event, scalars
from deploy.viewer.hand_curves import BOARD_NAMES, MOTORS_A_BOARD, TIPS, force_arrow, force_path

_ALL_TIPS = np.ones(len(TIPS), np.uint8)


class HandDrawer:
    """Turns `hand/joints` into curves, arrows, and lines of the log whenever something changes.

    A simulated hand sends none: what its steps tell is drawn until a driven hand has been heard.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._hand = task.hand if isinstance(task, DieTask) else Hand.RIGHT
        self._state = ""
        self._faults: tuple[str, ...] = ()

    def step(self, message: Step, when: When) -> Iterator[Drawing]:
        """Angles (rad) with what the last action asked for, and forces (N), of a hand that is not driven."""
        if self._state or not isinstance(self._task, DieTask):
            return
        angle_rad, force_n = (message.state[self._task.group(name).slice] for name in ("qpos", "tip_force"))
        target_rad = to_radians(message.prev_action) if message.k else angle_rad
        yield from _angles(angle_rad, target_rad, when)
        yield from self._forces(force_n, _ALL_TIPS, when)

    def draw(self, message: HandJoints, when: When) -> Iterator[Drawing]:
        """Angles in rad, currents in mA, forces in N, temperatures in °C, ages in ms; only what is valid."""
        yield from _angles(message.q_rad, message.target_rad, when)
        yield from self._forces(message.force_n, message.force_valid, when)
        for board, name in enumerate(BOARD_NAMES):
            first = MOTORS_A_BOARD * board
            current_ma = message.current_ma[first : first + MOTORS_A_BOARD]
            yield scalars(f"hand/current_ma/{name}", when, current_ma)
            yield scalars(f"hand/age_ms/{name}", when, message.board_age_ms[board])
            yield scalars(f"hand/rate_hz/{name}", when, message.board_rate_hz[board])
            if message.temperature_valid[board]:
                yield scalars(f"hand/temperature_c/{name}", when, message.temperature_c[board])
        yield from self._changes(message, when)

    def _forces(self, force_n: ArrayLike, valid: ArrayLike, when: When) -> Iterator[Drawing]:
        """Curves, and an arrow for each fingertip; none of either where it is not known."""
        for tip, force, known in zip(TIPS, np.asarray(force_n), np.asarray(valid), strict=True):
            shown = float(force) if known else 0.0
            yield Drawing(force_path(tip), when, Arrow(*force_arrow(shown, self._hand)))
            if known:
                yield scalars(f"hand/force_n/{tip}", when, force)

    def _changes(self, message: HandJoints, when: When) -> Iterator[Drawing]:
        if message.state != self._state:
            yield Drawing("state/hand", when, State(message.state))
        if (message.state, message.faults) == (self._state, self._faults):
            return
        self._state, self._faults = message.state, message.faults
        text = f"{message.state}: {'; '.join(message.faults)}" if message.faults else message.state
        yield event("hand_io", when, text, "WARN" if message.faults else "INFO")


def _angles(angle_rad: ArrayLike, target_rad: ArrayLike, when: When) -> Iterator[Drawing]:
    pairs = np.stack([np.asarray(angle_rad), np.asarray(target_rad)], axis=1)
    for joint, pair in zip(JOINTS, pairs, strict=True):
        yield scalars(f"hand/angle_rad/{joint.name}", when, pair)

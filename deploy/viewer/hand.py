"""Draws a real hand for people: joint by joint what it was told and does, fingertips, boards, faults."""

from __future__ import annotations

from collections.abc import Iterator

from common.dexhand021.tables import BOARDS, JOINTS
from common.hand_messages import HandJoints
from deploy.viewer.drawing import Drawing, When, event, scalars

_TIPS = tuple(board.name for board in BOARDS if board.has_tactile)


class HandDrawer:
    """Turns `hand/joints` into curves, and what is wrong into lines of the log whenever it changes."""

    def __init__(self) -> None:
        self._state = ""
        self._faults: tuple[str, ...] = ()

    def draw(self, message: HandJoints, when: When) -> Iterator[Drawing]:
        """Angles in rad, currents in mA, forces in N, temperatures in °C, ages in ms; only what is valid."""
        for index, joint in enumerate(JOINTS):
            yield scalars(f"hand/angle/{joint.name}", when, (message.q_rad[index], message.target_rad[index]))
        yield scalars("hand/current", when, message.current_ma)
        for name, force, valid in zip(_TIPS, message.force_n, message.force_valid, strict=True):
            if valid:
                yield scalars(f"hand/force/{name}", when, force)
        boards = zip(
            BOARDS, message.temperature_c, message.temperature_valid, message.board_age_ms, strict=True
        )
        for board, temperature_c, valid, age_ms in boards:
            yield scalars(f"hand/age/{board.name}", when, age_ms)
            if valid:
                yield scalars(f"hand/temperature/{board.name}", when, temperature_c)
        yield from self._changes(message, when)

    def _changes(self, message: HandJoints, when: When) -> Iterator[Drawing]:
        if (message.state, message.faults) == (self._state, self._faults):
            return
        self._state, self._faults = message.state, message.faults
        text = f"{message.state}: {'; '.join(message.faults)}" if message.faults else message.state
        yield event("hand_io", when, text, "WARN" if message.faults else "INFO")

"""Which faults are on at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from common.dexhand021.tables import BOARDS
from services.sim.emulator_config import Fault, FaultKind

NS_PER_S = 1e9
_NUMBERS = {board.name: number for number, board in enumerate(BOARDS)}


class Faults:
    """Faults with their beginnings and ends in ns."""

    def __init__(self, faults: Iterable[Fault], now_ns: int) -> None:
        self._windows: list[tuple[int, int, Fault]] = []
        for fault in faults:
            self.add(now_ns, fault)

    def add(self, now_ns: int, fault: Fault) -> None:
        """Have `fault`, `at_s` from now."""
        self._windows = [window for window in self._windows if window[1] > now_ns]
        begin_ns = now_ns + round(fault.at_s * NS_PER_S)
        self._windows.append((begin_ns, begin_ns + round(fault.for_s * NS_PER_S), fault))

    def _on(self, now_ns: int, kind: FaultKind, board: int | None) -> Iterator[Fault]:
        for begin_ns, end_ns, fault in self._windows:
            here = board is None or _NUMBERS[fault.board] == board
            if fault.kind is kind and here and begin_ns <= now_ns < end_ns:
                yield fault

    def active(self, now_ns: int, kind: FaultKind, board: int | None = None) -> bool:
        """Whether there is one of the kind (on board 0-5, if given)."""
        return any(self._on(now_ns, kind, board))

    def amount(self, now_ns: int, kind: FaultKind, board: int | None = None) -> float:
        """The sum of their amounts; 0 without any."""
        return sum(fault.amount for fault in self._on(now_ns, kind, board))

    def stalls(self, now_ns: int) -> list[tuple[int, int]]:
        """Board 0-5 and motor 0-1 of each obstruction."""
        return [(_NUMBERS[f.board], f.motor - 1) for f in self._on(now_ns, FaultKind.STALL, None)]

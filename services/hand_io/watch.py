"""What is wrong with the hand, judged from what its driver reports."""

# pyright: strict

from __future__ import annotations

from common.dexhand021.replies import MotorFlag
from common.dexhand021.tables import BOARDS, JOINTS
from common.hand_messages import HandFrame, Link
from services.hand_io.arming import Condition

DRIVER_SILENT_NS = 1_000_000_000
LOST = "the bus was lost"
EVENTS = {"starts": "a board has restarted", "down": LOST, "bus_off": LOST}  # by the driver's count


class Watch:
    """Remembers what a frame alone does not tell: what has happened since the last one."""

    def __init__(self, silent_ms: float) -> None:
        self._silent_ms = silent_ms
        self._seen: dict[str, float] = {}

    def judge(self, now_ns: int, frame: HandFrame | None) -> Condition:
        """Everything that keeps the hand from running."""
        if frame is None:
            return Condition(troubles=("the driver has said nothing yet",))
        happened = self._happened(frame)
        if frame.link is Link.DOWN:  # without which the boards are silent, too
            return Condition(faults(frame), (f"no bus: {frame.error}" if frame.error else "no bus",))
        return Condition(faults(frame), (*self._silent(now_ns, frame), *happened))

    def _silent(self, now_ns: int, frame: HandFrame) -> list[str]:
        if now_ns - frame.t_ns > DRIVER_SILENT_NS:
            return ["the driver is silent"]
        silent = [
            board.name for board, age in zip(BOARDS, frame.age_ms, strict=True) if age > self._silent_ms
        ]
        return [f"silent: {' '.join(silent)}"] if silent else []

    def _happened(self, frame: HandFrame) -> list[str]:
        now = {name: frame.counts.get(name, 0.0) for name in EVENTS}
        before, self._seen = self._seen or now, now
        return list(dict.fromkeys(words for name, words in EVENTS.items() if before[name] < now[name]))


def faults(frame: HandFrame) -> tuple[str, ...]:
    """What takes the torque off."""
    hot = [board.name for board, over in zip(BOARDS, frame.overheated, strict=True) if over]
    found = ["bus off"] if frame.link is Link.BUS_OFF else []
    return tuple(found + ([f"too hot: {' '.join(hot)}"] if hot else []))


def notes(frame: HandFrame) -> tuple[str, ...]:
    """What people should know although the hand goes on: motors in error, fingertips without a reading."""
    told = [
        f"{joint.name}: {MotorFlag(int(bits)).name or bits}"
        for joint, bits in zip(JOINTS, frame.flags, strict=True)
        if bits
    ]
    tips = [board.name for board in BOARDS if board.has_tactile]
    blind = [tip for tip, valid in zip(tips, frame.force_valid, strict=True) if not valid]
    return (*told, *(f"no force: {tip}" for tip in blind))

"""Whether the hand may move: HOLD, ARMED, RUNNING, RELAX, FAULT, and who may change that. Pure."""

# pyright: strict

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from common.hand_messages import ArmReply, ArmWish


class State(StrEnum):
    """What the hand may do."""

    HOLD = "hold"  # not armed: nothing moves it; every way back leads here
    ARMED = "armed"  # holds with torque and begins the next episode
    RUNNING = "running"
    RELAX = "relax"  # armed, but let go after a silence; moves again when there is something to do
    FAULT = "fault"  # no torque, until what is wrong is over


OPERATIONAL = (State.ARMED, State.RUNNING, State.RELAX)


@dataclass(frozen=True)
class Condition:
    """What is wrong now, in words: `faults` take the torque off, `troubles` only end what runs."""

    faults: tuple[str, ...] = ()
    troubles: tuple[str, ...] = ()

    @property
    def wrong(self) -> tuple[str, ...]:
        """Everything."""
        return (*self.faults, *self.troubles)


class Arming:
    """Only a person leads from HOLD to ARMED, or `auto` on a simulated bus; only trouble leads back.

    A fault is over, and HOLD reached, once nothing has been wrong for `recover_ns`.
    """

    def __init__(self, auto: bool, recover_ns: int) -> None:
        self._auto = auto
        self._recover_ns = recover_ns
        self._calm_since_ns: int | None = None
        self._condition = Condition(troubles=("nothing heard yet",))
        self.state = State.HOLD
        self.faults_seen = 0

    @property
    def operational(self) -> bool:
        """Whether episodes may run."""
        return self.state in OPERATIONAL

    def wish(self, wish: ArmWish) -> ArmReply:
        """Answer a person; what is wrong is the reason of a refusal, or told with the status."""
        if wish is ArmWish.STATUS:
            return ArmReply(True, self.state.value, "; ".join(self._condition.wrong))
        reason = self._follow(wish)
        return ArmReply(accepted=not reason, state=self.state.value, reason=reason)

    def _follow(self, wish: ArmWish) -> str:
        if wish is ArmWish.DISARM:
            if self.operational:
                self.state = State.HOLD
            self._auto = False  # who stops a hand wants it to stay stopped
            return ""
        if self.operational:
            return ""
        if self.state is State.FAULT or self._condition.wrong:
            return "; ".join(self._condition.wrong) or "the fault has only just passed"
        self.state = State.ARMED
        return ""

    def update(self, now_ns: int, condition: Condition, busy: bool, relaxed: bool) -> None:
        """Follow what the hand reports; `busy` with an episode, `relaxed` without torque though armed."""
        self._condition = condition
        calm = self._calm(now_ns, condition.wrong)
        if condition.faults:
            self.faults_seen += self.state is not State.FAULT
            self.state = State.FAULT
        elif self.state is State.FAULT:
            self.state = State.HOLD if calm else State.FAULT
        elif self.operational:
            self.state = State.HOLD if condition.troubles else _armed(busy, relaxed)
        elif self._auto and calm:
            self.state = State.ARMED

    def _calm(self, now_ns: int, wrong: Sequence[str]) -> bool:
        if wrong:
            self._calm_since_ns = None
        elif self._calm_since_ns is None:
            self._calm_since_ns = now_ns
        return self._calm_since_ns is not None and now_ns - self._calm_since_ns >= self._recover_ns


def _armed(busy: bool, relaxed: bool) -> State:
    if relaxed:
        return State.RELAX
    return State.RUNNING if busy else State.ARMED

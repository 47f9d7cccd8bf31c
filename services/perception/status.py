"""What perception says of itself: one state and one line, from pictures, poses and silences."""

# pyright: strict

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from common.camera_messages import PoseState
from common.config import Frozen
from services.perception.backend import PoseEstimate, Unseen

NS_PER_S = 1e9


class SilenceConfig(Frozen):
    """How long a silence of the camera is borne."""

    suspect_s: float = Field(default=0.3, gt=0.0, description="without a fit picture: the pose is suspect")
    lost_s: float = Field(default=1.0, gt=0.0, description="and after so long, lost")


@dataclass(frozen=True)
class Said:
    """The state and, for people, what is wrong; empty: nothing."""

    state: PoseState
    message: str


NO_PICTURE = "no picture yet: is the camera plugged in, and its process running?"


class Status:
    """Joins what backend, screen and clock say; a pose is good only while all of them agree."""

    def __init__(self, config: SilenceConfig) -> None:
        self._suspect_ns = config.suspect_s * NS_PER_S
        self._lost_ns = config.lost_s * NS_PER_S
        self._result = Said(PoseState.SEARCHING, NO_PICTURE)
        self._fit_ns: int | None = None  # when the newest fit picture came
        self._refused = ""  # why the newest picture was not fit
        self._came_ns: int | None = None  # when the newest picture came, fit or not
        self._warning = ""

    @property
    def state(self) -> PoseState:
        """What the newest result says, whatever the camera does since."""
        return self._result.state

    def fit(self, now_ns: int) -> None:
        """A fit picture came."""
        if self._fit_ns is None and self._result.message == NO_PICTURE:
            self._result = Said(PoseState.SEARCHING, "")
        self._fit_ns = self._came_ns = now_ns
        self._refused = ""

    def refused(self, now_ns: int, message: str) -> None:
        """A picture came that is not fit."""
        self._came_ns, self._refused = now_ns, message

    def found(self, estimate: PoseEstimate, doubt: str) -> None:
        """A pose was found; `doubt` says why it is not to be believed although its backend believes it."""
        state = PoseState.SUSPECT if doubt else estimate.state
        unsure = "too little of the die is seen, or it does not look as it should"
        self._result = Said(state, doubt or ("" if estimate.claimed else unsure))

    def unseen(self, unseen: Unseen) -> None:
        """No pose was found where it was expected; what a search has said meanwhile stays."""
        searching = self._result.state in (PoseState.SEARCHING, PoseState.LOST)
        if not (searching and self._result.message):
            self._result = Said(unseen.state, unseen.message)

    def searched(self, unseen: Unseen) -> None:
        """Nor was one found anywhere."""
        had = self._result.state is PoseState.LOST
        self._result = Said(PoseState.LOST if had else unseen.state, unseen.message)

    def warn(self, message: str) -> None:
        """Something is wrong with the camera itself, until an empty text takes that back."""
        self._warning = message

    def lose(self) -> None:
        """Nobody knows any more where the die is."""
        self._result = Said(PoseState.LOST, "")

    def trouble(self, message: str) -> None:
        """The backend failed."""
        had = self._result.state in (PoseState.TRACKING, PoseState.SUSPECT, PoseState.LOST)
        self._result = Said(PoseState.LOST if had else PoseState.SEARCHING, message)

    def reset(self) -> None:
        """A person wants a new search."""
        self._result = Said(PoseState.SEARCHING, "")

    def silent(self, now_ns: int) -> bool:
        """Whether no fit picture came for so long that the die may be anywhere by now."""
        return self._fit_ns is not None and now_ns - self._fit_ns >= self._lost_ns

    def now(self, now_ns: int) -> Said:
        """State and message at a time."""
        why = self._silence(now_ns)
        if self._fit_ns is None:
            return Said(PoseState.SEARCHING, why)
        age_ns = now_ns - self._fit_ns
        if age_ns < self._suspect_ns:
            return Said(self._result.state, self._warning or self._result.message)
        if self._result.state not in (PoseState.TRACKING, PoseState.SUSPECT):
            return Said(self._result.state, why)
        return Said(PoseState.LOST if age_ns >= self._lost_ns else PoseState.SUSPECT, why)

    def _silence(self, now_ns: int) -> str:
        """Why there is no fit picture: what is wrong with those that come, or that none comes."""
        if self._came_ns is None:
            return NO_PICTURE
        age_ns = now_ns - self._came_ns
        if self._refused and age_ns < self._suspect_ns:
            return self._refused
        return f"no picture for {age_ns / NS_PER_S:.1f} s: is the camera unplugged?"

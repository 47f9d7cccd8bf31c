"""What a service is: a state machine without socket, clock or device; and what it may ask of its runner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from common.bus import Inbox, Input
from common.messages import Message
from common.topics import Topic


@dataclass(frozen=True)
class Publish:
    """Send a message. `suffix` replaces the `*` of the topic's key."""

    topic: Topic
    message: Message
    suffix: str = ""
    t_ns: int | None = None  # capture time; None: now
    valid: bool = True


@dataclass(frozen=True)
class Job:
    """Long work. Live it runs in a worker, in lock-step at once; its result arrives in `inbox.results`.

    `latency_ns` is the declared duration, used in lock-step only. Jobs of one lane run one at a time, in the
    order given; those of different lanes run beside each other and must not share what they change.
    """

    name: str
    function: Callable[..., object]
    arguments: tuple[Any, ...] = ()
    latency_ns: int = 0
    lane: str = "main"


@dataclass(frozen=True)
class ToPort:
    """A command for a device; the answers arrive as messages of the port's topics."""

    port: str
    topic: Topic
    message: Message


@dataclass(frozen=True)
class Finish:
    """The service has done all that it was started for; the runner ends its process with `code`."""

    code: int = 0


Output = Publish | Job | ToPort | Finish


@dataclass(frozen=True)
class Report:
    """What a service says of itself in its heartbeat."""

    state: str
    fields: dict[str, float] = field(default_factory=dict[str, float])


class Service(Protocol):
    """A state machine: `step` is called at ticks, on waking inputs and on job results."""

    name: str
    inputs: tuple[Input, ...]
    period_ns: int | None  # None: only woken by inputs and results

    @property
    def boot_id(self) -> int:
        """Id of this start, which all its messages carry."""
        ...

    def step(self, now_ns: int, inbox: Inbox) -> list[Output]:
        """Advance by one step; must return within a few milliseconds."""
        ...

    def stop(self, now_ns: int) -> list[Output]:
        """Save what must survive; called once at the end of the process."""
        ...

    def report(self) -> Report:
        """Describe the present state for the heartbeat; must be cheap."""
        ...


class Port(Protocol):
    """A device owned by a runner."""

    name: str

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Start; `deliver` may be called from any thread."""
        ...

    def write(self, message: Message) -> None:
        """Pass a command to the device."""
        ...

    def close(self) -> None:
        """Leave the device in a safe state."""
        ...

"""What a service's `build` returns, and the codec of a task: shared by processes and lock-step runs."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from common.codec import Codec
from common.service import Port, Service
from common.task import get_task


@dataclass(frozen=True)
class Built:
    """A service, the devices that its runner owns, and by key who answers queries, on any thread."""

    service: Service
    ports: Mapping[str, Port] = field(default_factory=dict[str, Port])
    queries: Mapping[str, Callable[[bytes], bytes]] = field(
        default_factory=dict[str, Callable[[bytes], bytes]]
    )


def codec_for(task_name: str) -> Codec:
    """Return the codec whose S, A, G and V are those of the task."""
    task = get_task(task_name)
    return Codec({"S": task.state_dim, "A": task.action_dim, "G": task.goal_dim, "V": len(task.groups)})


def new_boot_id() -> int:
    """Draw an id that no other start of any process has."""
    return secrets.randbits(61) + 1

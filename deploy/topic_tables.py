"""The tables of the bus: every topic with its delivery and readers, every message with its fields."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from common.messages import ArraySpec, Header, Message, Range
from common.service import Service
from common.topics import PORTS, TOPICS, Topic
from deploy.curriculum import CurriculumService
from deploy.markdown import Row, code, table
from deploy.viewer.service import ViewerService
from deploy.watchdog import Watchdog
from services.hand_io.service import HandIoService
from services.learner.service import LearnerService
from services.perception.service import PerceptionService
from services.planner.service import PlannerService
from services.sim.camera_service import CameraService
from services.sim.emulator_service import EmulatorService
from services.sim.service import SimService

READERS: Mapping[str, type[Service]] = types.MappingProxyType(
    {
        "sim": SimService,
        "hand_io": HandIoService,
        "emulator": EmulatorService,
        "camera": CameraService,
        "perception": PerceptionService,
        "planner": PlannerService,
        "learner": LearnerService,
        "curriculum": CurriculumService,
        "viewer": ViewerService,
        "watchdog": Watchdog,
    }
)
_COMMENTED = re.compile(r"^    (\w+):.*?  # (.+)$", re.MULTILINE)
_LETTERS = {"<f4": "float32", "<f8": "float64", "|u1": "uint8", "<u2": "uint16"}


def topics() -> str:
    """One row per key of the bus and of the ports."""
    heads = (
        "key",
        "message",
        "carries",
        "rate",
        "priority",
        "if the link is full",
        "kept",
        "limit",
        "read by",
    )
    return table(heads, (_topic_row(topic) for topic in (*TOPICS, *PORTS)))


def _topic_row(topic: Topic) -> Row:
    kept = f"{topic.latched}{', asked for again' if topic.recovered else ''}" if topic.latched else "–"
    read_by = [name for name, service in READERS.items() if any(i.topic is topic for i in service.inputs)]
    port = topic.key.startswith("port/")
    return (
        code(topic.key),
        f"[`{topic.message.__name__}`](#{topic.message.__name__.lower()})",
        topic.about,
        f"{topic.rate_hz:g} Hz" if topic.rate_hz else "on events",
        "–" if port else topic.priority.value,
        "–" if port else ("wait" if topic.block else "drop"),
        kept,
        _size(topic.max_bytes),
        ", ".join(read_by) or ("its device" if port else "–"),
    )


def _size(count: int) -> str:
    return f"{count // 1024**2} MiB" if count >= 1024**2 else f"{count // 1024} KiB"


def messages() -> str:
    """One section per message: what it is for, and its fields."""
    kinds: list[type[Any]] = [Header, *get_args(Message)]
    return "\n".join(_message(kind) for kind in kinds)


def _message(kind: type[Any]) -> str:
    remarks = dict(_COMMENTED.findall(inspect.getsource(kind)))
    hints = get_type_hints(kind, include_extras=True)
    rows = ((code(name), _form(hint), _unit(hint), remarks.get(name, "")) for name, hint in hints.items())
    intro = " ".join((inspect.getdoc(kind) or "").split())
    return f"#### {kind.__name__}\n\n{intro}\n\n{table(('field', 'form', 'unit or bounds', 'remark'), rows)}"


def _form(hint: Any) -> str:
    """Name the type and shape of a field."""
    if get_origin(hint) is Annotated:
        bare, rule = get_args(hint)[:2]
        if not isinstance(rule, ArraySpec):
            return _form(bare)
        letters = ", ".join(map(str, rule.shape))
        return f"({letters}{',' if len(rule.shape) == 1 else ''}) {_LETTERS[rule.dtype]}"
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return f"one of {', '.join(hint)}"
    if get_origin(hint):
        names = ", ".join(each.__name__ for each in get_args(hint) if each is not Ellipsis)
        return f"{'map' if get_origin(hint) is dict else 'list'} of {names}"
    return str(hint.__name__)


def _unit(hint: Any) -> str:
    rule = get_args(hint)[1] if get_origin(hint) is Annotated else None
    if isinstance(rule, ArraySpec):
        return f"{rule.unit}; magnitude ≤ {rule.limit:g}"
    if isinstance(rule, Range):
        high = (
            f"2^{rule.high.bit_length() - 1}"
            if isinstance(rule.high, int) and rule.high > 1e9
            else f"{rule.high:g}"
        )
        return f"{rule.low:g} to {high} {rule.unit}"
    return ""

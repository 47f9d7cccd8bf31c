"""What is drawn, as plain values: an entity's path, its moment on the three timelines, and a value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Level = str  # INFO, WARN or ERROR


@dataclass(frozen=True)
class When:
    """A moment: control steps since the viewer's start, ns since the epoch, and the episode's id."""

    step: int
    t_ns: int
    episode: int


@dataclass(frozen=True)
class Scalars:
    """Points of n curves (n,), in the unit that the path names."""

    values: NDArray[np.float64]


@dataclass(frozen=True)
class Poses:
    """Frames (n) at positions (n, 3) m and quaternions wxyz (n, 4), world frame."""

    frames: tuple[str, ...]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]


@dataclass(frozen=True)
class Segments:
    """Line segments (n, 2, 3), m, world frame, with a colour (r, g, b) each."""

    points: NDArray[np.float64]
    colours: tuple[tuple[int, int, int], ...]


@dataclass(frozen=True)
class Arrow:
    """An arrow from `origin` (3,) along `vector` (3,), m, in the frame of the entity."""

    origin: NDArray[np.float64]
    vector: NDArray[np.float64]


@dataclass(frozen=True)
class Picture:
    """A JPEG file."""

    data: bytes


@dataclass(frozen=True)
class Bars:
    """A bar chart of values (n,)."""

    values: NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """What something is from now on, until it is something else."""

    label: str


@dataclass(frozen=True)
class Event:
    """A line of the log."""

    text: str
    level: Level = "INFO"


Value = Scalars | Poses | Segments | Arrow | Picture | Bars | State | Event


@dataclass(frozen=True)
class Drawing:
    """One value of one entity at one moment."""

    path: str
    when: When
    value: Value


def scalars(path: str, when: When, values: ArrayLike) -> Drawing:
    """Points of as many curves as there are values."""
    return Drawing(path, when, Scalars(np.atleast_1d(np.asarray(values, dtype=np.float64))))


def event(source: str, when: When, text: str, level: Level = "INFO") -> Drawing:
    """A line that `source` adds to the log."""
    return Drawing(f"log/{source}", when, Event(f"{source}: {text}", level))

"""What the fields of messages are made of: arrays with shape and unit, bounded numbers, ids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]


@dataclass(frozen=True)
class ArraySpec:
    """What the codec demands of an array: little-endian dtype, shape letters or numbers, unit, bounds."""

    dtype: str
    shape: tuple[str | int, ...]
    unit: str
    limit: float = 1e6  # largest accepted magnitude; non-finite values are always refused


@dataclass(frozen=True)
class Range:
    """Closed interval that the codec demands of a number."""

    low: float
    high: float
    unit: str = ""


Count = Annotated[int, Range(0, 2**62)]
BootId = Annotated[int, Range(1, 2**62)]

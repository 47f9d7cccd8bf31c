"""Ceiling rate: the fastest known way to do a batched float32 matrix product at given shapes, measured now.

A shape (B, N, K, J) is B independent products (N, K) @ (K, J), 2*B*N*K*J floating-point operations.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

Shape = tuple[int, int, int, int]
Kernel = Callable[[], object]


@dataclass(frozen=True)
class ShapeCeiling:
    """Rates of every kernel at one shape, in GFLOP/s; `best` names the fastest."""

    shape: Shape
    count: int
    rates: Mapping[str, float]
    best: str

    @property
    def gflops(self) -> float:
        return self.rates[self.best]

    @property
    def seconds(self) -> float:
        """Time of the `count` products at the best rate."""
        return self.count * flops(self.shape) / (self.gflops * 1e9)


@dataclass(frozen=True)
class CeilingResult:
    """The best rate of each shape, and of the whole weighted list in GFLOP/s."""

    shapes: tuple[ShapeCeiling, ...]

    @property
    def gflops(self) -> float:
        work = sum(each.count * flops(each.shape) for each in self.shapes)
        return work / self.seconds / 1e9

    @property
    def seconds(self) -> float:
        """Time of the whole list if every product ran at its best rate."""
        return sum(each.seconds for each in self.shapes)

    def as_json(self) -> dict[str, object]:
        return {
            "gflops": self.gflops,
            "shapes": [
                {"shape": each.shape, "count": each.count, "best": each.best, "rates": dict(each.rates)}
                for each in self.shapes
            ],
        }


def flops(shape: Shape) -> int:
    """Floating-point operations of one product of `shape`: a multiplication and an addition each."""
    B, N, K, J = shape
    return 2 * B * N * K * J


def ceiling(
    shapes: Sequence[Shape],
    threads: int = 1,
    device: str = "cpu",
    counts: Sequence[int] | None = None,
    repeats: int = 7,
) -> CeilingResult:
    """Measure the ceiling of each shape; `counts[i]` weighs shape i (default 1 each).

    Candidates: mm per member, bmm, baddbmm with a bias row, numpy sgemm per member (CPU only).
    """
    weights = list(counts) if counts is not None else [1] * len(shapes)
    with torch_threads(threads), torch.no_grad():
        measured = [
            _measure(shape, count, device, threads, repeats)
            for shape, count in zip(shapes, weights, strict=True)
        ]
    return CeilingResult(tuple(measured))


def seconds_per_call(kernel: Kernel, device: str, threads: int, repeats: int = 7) -> float:
    """Time of one call in the quickest of `repeats` rounds of at least 20 ms each, after a warm-up call.

    The quickest, because other work on the machine only ever adds time.
    """
    kernel()
    once = _elapsed(kernel, 1, device, threads)
    calls = max(1, int(0.02 / max(once, 1e-7)))
    return min(_elapsed(kernel, calls, device, threads) / calls for _ in range(repeats))


def clock(device: str, threads: int) -> Callable[[], float]:
    """The clock that fits: processor time on one CPU thread, wall time otherwise.

    Processor time equals wall time on an idle core and stays right when the core is shared.
    """
    return time.process_time if device == "cpu" and threads == 1 else time.perf_counter


@contextmanager
def torch_threads(threads: int) -> Iterator[None]:
    """Give torch and numpy `threads` threads inside the block, and restore torch's afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    _set_numpy_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _measure(shape: Shape, count: int, device: str, threads: int, repeats: int) -> ShapeCeiling:
    kernels = _kernels(shape, device, _set_numpy_threads(threads))
    rates = {
        name: flops(shape) / seconds_per_call(kernel, device, threads, repeats) / 1e9
        for name, kernel in kernels.items()
    }
    return ShapeCeiling(shape, count, rates, max(rates, key=lambda name: rates[name]))


def _kernels(shape: Shape, device: str, with_numpy: bool) -> dict[str, Kernel]:
    B, N, K, J = shape
    generator = torch.Generator().manual_seed(0)
    x = torch.randn((B, N, K), generator=generator).to(device)
    w = torch.randn((B, K, J), generator=generator).to(device)
    bias = torch.randn((B, 1, J), generator=generator).to(device)
    out = torch.empty((B, N, J), device=device)
    kernels: dict[str, Kernel] = {
        "mm": lambda: _mm_per_member(x, w, out),
        "bmm": lambda: torch.bmm(x, w, out=out),
        "baddbmm": lambda: torch.baddbmm(bias, x, w, out=out),
    }
    if device == "cpu" and with_numpy:
        xs, ws, outs = x.numpy(), w.numpy(), np.empty((B, N, J), np.float32)
        kernels["numpy"] = lambda: [np.matmul(xs[b], ws[b], out=outs[b]) for b in range(B)]
    return kernels


def _mm_per_member(x: Tensor, w: Tensor, out: Tensor) -> None:
    for b in range(x.shape[0]):
        torch.mm(x[b], w[b], out=out[b])


def _elapsed(kernel: Kernel, calls: int, device: str, threads: int) -> float:
    now = clock(device, threads)
    _synchronise(device)
    start = now()
    for _ in range(calls):
        kernel()
    _synchronise(device)
    return now() - start


def _synchronise(device: str) -> None:
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)


def _set_numpy_threads(threads: int) -> bool:
    """Set the threads of the OpenBLAS inside numpy's wheel; False when there is none to set.

    numpy itself has no such call, and an environment variable would have to precede its import.
    """
    for path in sorted(Path(np.__file__).parent.parent.glob("numpy.libs/libscipy_openblas64*")):
        setter = getattr(ctypes.CDLL(str(path)), "scipy_openblas_set_num_threads64_", None)
        if setter is not None:
            setter(ctypes.c_int(threads))
            return True
    return False

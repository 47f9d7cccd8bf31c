"""Figures of many judged sequences, as plain numbers for JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.perception.judge import HIDDEN, Judged, reacquired_after

BANDS = ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6))
FINE = tuple((low / 10, (low + 1) / 10) for low in range(6))
REACQUIRE_FRAMES = 30


def bands(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """A row for each band of occlusion, with one for each mean speed of the die inside."""
    speeds = sorted({one.sequence.spec.speed_deg_s for one in judged})
    return [
        {
            "occlusion": list(band),
            **figures(judged, band),
            "by_speed_deg_s": {
                f"{speed:g}": figures([j for j in judged if j.sequence.spec.speed_deg_s == speed], band)
                for speed in speeds
            },
        }
        for band in BANDS
    ]


def errors_by_occlusion(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Rows for a picture: every tenth of occlusion in which there are frames."""
    rows: list[dict[str, Any]] = []
    for band in FINE:
        full = figures(judged, band)
        kept = {name: full[name] for name in ("frames", "within_5deg_3mm", "rotation_deg", "translation_mm")}
        if full["frames"]:
            rows.append({"occlusion": list(band), **kept})
    return rows


def figures(judged: Iterable[Judged], band: tuple[float, float] = (0.0, HIDDEN)) -> dict[str, Any]:
    """Figures of all frames in a band of occlusion from the first registration of each sequence on."""
    parts = [(one, _in_band(one, band)) for one in judged]
    rotation, modulo, translation, within, claimed, gross, labelled, posed = (
        np.concatenate([getattr(one, name)[chosen] for one, chosen in parts] or [np.zeros(0)])
        for name in (
            "rotation_deg", "modulo_deg", "translation_mm", "within", "claimed", "gross", "labelled", "posed"
        )
    )  # fmt: skip
    return {
        "frames": len(posed),
        "within_5deg_3mm": share(within),
        "posed": share(posed),
        "rotation_deg": spread(rotation),
        "modulo_24_deg": spread(modulo),
        "translation_mm": spread(translation),
        "label_accuracy": share(labelled[posed.astype(bool)]),
        "claimed": share(claimed),
        "claimed_within_5deg_3mm": share(within[claimed.astype(bool)]),
        "gross_claimed": share(gross[claimed.astype(bool)]),
        **{name: spread(values) for name, values in _surface(parts).items()},
    }


def gross_claimed(judged: Sequence[Judged]) -> dict[str, Any]:
    """Gross errors among all poses marked claimed, whatever the occlusion."""
    claimed = sum(int(one.claimed.sum()) for one in judged)
    gross = sum(int((one.claimed & one.gross).sum()) for one in judged)
    return {"share": gross / claimed if claimed else None, "gross": gross, "claimed": claimed}


def reacquired(judged: Sequence[Judged]) -> dict[str, Any]:
    """Trials of hiding the die: how soon it was there again, and what was claimed meanwhile."""
    trials = [after for one in judged for after in reacquired_after(one, REACQUIRE_FRAMES)]
    found = [after for after in trials if after is not None]
    hidden = [one.sequence.occlusion > HIDDEN for one in judged]
    claims = sum(int((one.claimed & where).sum()) for one, where in zip(judged, hidden, strict=True))
    return {
        "trials": len(trials),
        "share": sum(after <= REACQUIRE_FRAMES for after in found) / len(trials) if trials else None,
        "frames": spread(np.array(found, np.float64)),
        "hidden_frames": sum(int(where.sum()) for where in hidden),
        "claimed_while_hidden": claims,
    }


def times(judged: Sequence[Judged]) -> dict[str, Any]:
    """Milliseconds a frame on the clock and on the processor, frames without a pose left out.

    The 95th percentile comes thrice: of all frames, of those fitted from one start, of those from several.
    """
    attempts = np.concatenate([one.answers.attempts for one in judged] or [np.zeros(0)])
    result: dict[str, Any] = {"retried": share(attempts[attempts > 0] > 1)}
    for name in ("frame_ms", "frame_cpu_ms"):
        values = np.concatenate([getattr(one.answers, name) for one in judged] or [np.zeros(0)])
        result[f"{name}_median"] = quantile(values[attempts > 0], 0.5)
        result[f"{name}_p95"] = quantile(values[attempts > 0], 0.95)
        result[f"{name}_p95_without_retries"] = quantile(values[attempts == 1], 0.95)
        result[f"{name}_p95_of_retried"] = quantile(values[attempts > 1], 0.95)
    registered = [ms for one in judged for ms in one.answers.register_cpu_ms]
    return {**result, "register_cpu_ms": spread(np.array(registered))}


def share(where: NDArray[Any]) -> float | None:
    """The part that is true; None of nothing."""
    return float(np.mean(where)) if len(where) else None


def spread(values: NDArray[np.float64]) -> dict[str, float | None]:
    """Median and 90th percentile of what is finite."""
    finite = values[np.isfinite(values)]
    return {"median": quantile(finite, 0.5), "p90": quantile(finite, 0.9)}


def quantile(values: NDArray[np.float64], q: float) -> float | None:
    """A quantile; None of nothing."""
    return float(np.quantile(values, q)) if len(values) else None


def _in_band(one: Judged, band: tuple[float, float]) -> NDArray[np.bool_]:
    occlusion = one.sequence.occlusion[: len(one.started)]
    return one.started & (occlusion >= band[0]) & (occlusion < band[1])


def _surface(parts: list[tuple[Judged, NDArray[np.bool_]]]) -> dict[str, NDArray[np.float64]]:
    errors: dict[str, list[NDArray[np.float64]]] = {"add_mm": [], "add_s_mm": [], "mssd_mm": []}
    for one, chosen in parts:
        for name, values in one.surface_errors_mm.items():
            errors[name].append(values[chosen[one.posed]])
    return {name: np.concatenate(values or [np.zeros(0)]) for name, values in errors.items()}


def one_line(one: Judged) -> dict[str, Any]:
    """The least that tells how a sequence went."""
    return {
        "occlusion": quantile(one.sequence.occlusion, 0.5),
        "frames_before_found": int((~one.started).sum()),
        "within_5deg_3mm": share(one.within[one.started]),
        "claimed": share(one.claimed[one.started]),
        "gross_claimed": int((one.claimed & one.gross).sum()),
        "frame_cpu_ms_median": quantile(np.array(one.answers.frame_cpu_ms), 0.5),
    }

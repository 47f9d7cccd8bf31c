"""Tables of how well the die is found, from the committed results of `bench.perception`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from deploy.markdown import Row, table
from deploy.supervisor import REPOSITORY

RESULTS = REPOSITORY / "bench" / "results"
Result = Mapping[str, Any]


def pose_bars() -> str:
    """One row per bar: what is asked for, and what was measured."""
    result = _read("perception.json")
    low, middle, _ = result["bands"]
    speeds, trials = middle["by_speed_deg_s"], result["reacquisition"]
    gross = result["gross_claimed_counts"]
    rows: tuple[tuple[str, str, float, bool, str], ...] = (
        _least("0-20 % covered: within 5 deg and 3 mm", 0.99, low["within_5deg_3mm"], low["frames"]),
        _least("20-40 %, 70 deg/s", 0.94, speeds["70"]["within_5deg_3mm"], speeds["70"]["frames"]),
        _least("20-40 %, 175 deg/s", 0.91, speeds["175"]["within_5deg_3mm"], speeds["175"]["frames"]),
        _most("gross errors among claimed poses", 0.002, result["gross_claimed"], gross["near"]["claimed"]),
        _most("the same in the trials", 0.002, gross["trials"]["share"], gross["trials"]["claimed"]),
        _most("the same at 0.60 m, 30 Hz", 0.01, result["gross_claimed_far"], gross["far"]["claimed"]),
        _least("found again within 30 frames", 0.95, result["reacquired"], trials["trials"]),
        _most("claimed while hidden", 0, trials["claimed_while_hidden"], trials["hidden_frames"]),
        _most("median frame, ms", 6, result["frame_ms_median"]),
        _most("95 % of frames without retries, ms", 10, result["frame_ms_p95_without_retries"]),
        _most("95 % of all frames, ms", 25, result["frame_ms_p95"]),
    )
    return table(
        ("", "bar", "measured", "of", ""),
        (
            (what, bar, f"{value:.3g}", of, "met" if met else "**missed**")
            for what, bar, value, met, of in rows
        ),
    )


def _least(what: str, bar: float, value: float, of: int) -> tuple[str, str, float, bool, str]:
    return what, f"≥ {bar:g}", value, value >= bar, str(of)


def _most(what: str, bar: float, value: float, of: int | None = None) -> tuple[str, str, float, bool, str]:
    return what, f"≤ {bar:g}", value, value <= bar, "–" if of is None else str(of)


def pose_bands() -> str:
    """One row per band of occlusion: ours from the first pose on, a plain ICP over all frames."""
    result = _read("perception.json")
    icp = result["baseline"]["bands"]
    all_near = [band["frames"] for band in icp]  # it begins with the true pose, so it has them all
    parts = (
        ("ours", "0.42 m", result["bands"], all_near),
        ("plain ICP", "0.42 m", icp, all_near),
        ("ours", "0.60 m", result["bands_far"], [None] * 3),
    )
    heads = ("", "covered", "frames", "within 5 deg, 3 mm", "of all frames")
    heads += (
        "rotation, deg",
        "translation, mm",
        "modulo 24, deg",
        "labelling right",
        "ADD, mm",
        "ADD-S, mm",
        "MSSD, mm",
        "claimed",
    )
    return table(
        heads,
        [
            _band(f"{name}, {far}", band, frames)
            for name, far, bands, total in parts
            for band, frames in zip(bands, total, strict=True)
        ],
    )


def _band(name: str, band: Result, frames: int | None) -> Row:
    low, high = band["occlusion"]
    claims = band["claimed"] if name.startswith("ours") else None
    return (
        name,
        f"{100 * low:.0f}-{100 * high:.0f} %",
        str(band["frames"]),
        _share(band["within_5deg_3mm"]),
        _share(band["within_5deg_3mm"] * band["frames"] / frames if frames else None),
        *(_spread(band[kind]) for kind in ("rotation_deg", "translation_mm", "modulo_24_deg")),
        _share(band["label_accuracy"]),
        *(_spread(band[kind]) for kind in ("add_mm", "add_s_mm", "mssd_mm")),
        _share(claims),
    )


def pose_looks() -> str:
    """One row per appearance of the die and lighting."""
    heads = ("die", "light", "frames until told", "within 5 deg, 3 mm", "rotation, deg", "translation, mm")
    heads += ("claimed", "of these within", "gross claimed")
    return table(heads, map(_look, _read("perception_looks.json")["looks"]))


def _look(row: Result) -> Row:
    return (
        row["appearance"],
        row["lighting"],
        str(row["frames_before_found"]),
        _share(row["within_5deg_3mm"]),
        _spread(row["rotation_deg"]),
        _spread(row["translation_mm"]),
        _share(row["claimed"]),
        _share(row["claimed_within_5deg_3mm"]),
        _share(row["gross_claimed"]),
    )


def pose_times() -> str:
    """Processor time a frame, ours and the plain ICP's, taken in the same run on one core."""
    result = _read("perception.json")
    icp, ratio = result["baseline"], result["frame_ms_to_baseline"]
    rows = (
        (what, *(f"{part[name]:.1f}" for part in (result, icp)), f"{ratio[name]:.2f}")
        for what, name in (("median", "frame_cpu_ms_median"), ("95th percentile", "frame_cpu_ms_p95"))
    )
    return table(("processor time a frame", "ours, ms", "plain ICP, ms", "ratio"), rows)


def _read(name: str) -> Result:
    return json.loads((RESULTS / name).read_text(encoding="ascii"))


def _share(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _spread(value: Result) -> str:
    """Median and 90th percentile."""
    return "–" if value["median"] is None else f"{value['median']:.2g}, {value['p90']:.2g}"

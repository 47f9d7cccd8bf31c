"""`python -m bench.perception.figure RESULT.json OUT.png`: errors by occlusion, beside a plain ICP's."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

_SIZE_IN, _DPI = (11.0, 3.2), 110
_COLOURS = {"ours": "C0", "plain ICP": "C1"}


def draw(result: dict[str, Any], out: Path) -> None:
    """Draw the `errors_by_occlusion` of a result and of its baseline. Raises KeyError if it has none."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    curves = {"ours": result["errors_by_occlusion"]}
    if "errors_by_occlusion" in result["baseline"]:
        curves["plain ICP"] = result["baseline"]["errors_by_occlusion"]
    figure, axes = plt.subplots(1, 3, figsize=_SIZE_IN, layout="constrained")
    for name, rows in curves.items():
        _share(axes[0], rows, name)
        _error(axes[1], rows, name, "rotation_deg")
        _error(axes[2], rows, name, "translation_mm")
    for axis, title in zip(
        axes, ("frames within 5 deg and 3 mm, %", "rotation, deg", "translation, mm"), strict=True
    ):
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("of the die covered, %", fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylim(-3.0, 103.0)
    axes[0].legend(fontsize=8, frameon=False)
    axes[1].axhline(5.0, color="0.5", lw=0.8, ls=":")
    axes[2].axhline(3.0, color="0.5", lw=0.8, ls=":")
    figure.suptitle(
        "0.42 m, 60 Hz, held-out sequences; line: median, shaded up to the 90th percentile", fontsize=9
    )
    figure.savefig(out, dpi=_DPI)
    plt.close(figure)


def _middle(row: dict[str, Any]) -> float:
    return 50.0 * sum(row["occlusion"])


def _share(axis: Any, rows: list[dict[str, Any]], name: str) -> None:
    shares = [100.0 * row["within_5deg_3mm"] for row in rows]
    axis.plot([_middle(row) for row in rows], shares, "o-", ms=4, color=_COLOURS[name], label=name)


def _error(axis: Any, rows: list[dict[str, Any]], name: str, kind: str) -> None:
    at = [_middle(row) for row in rows]
    median, high = ([row[kind][part] for row in rows] for part in ("median", "p90"))
    axis.plot(at, median, "o-", ms=4, color=_COLOURS[name])
    axis.fill_between(at, median, high, color=_COLOURS[name], alpha=0.2, lw=0)
    axis.set_yscale("log")


def main(arguments: list[str] | None = None) -> int:
    """Read a result of `python -m bench.perception --json` and draw it."""
    parser = argparse.ArgumentParser(prog="bench.perception.figure", description=__doc__)
    parser.add_argument("result", type=Path)
    parser.add_argument("out", type=Path)
    chosen = parser.parse_args(arguments)
    draw(json.loads(chosen.result.read_text(encoding="ascii")), chosen.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())

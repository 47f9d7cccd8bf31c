"""`python -m bench.perception.generate --out DIR --suite SUITE`: films sequences of the die."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from bench.perception.library import load, make, suite


def main(arguments: list[str] | None = None) -> int:
    """Make what is missing, and print a line for each sequence."""
    parser = argparse.ArgumentParser(prog="bench.perception.generate", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the sequences, outside git")
    parser.add_argument("--suite", choices=("tuning", "held_out", "looks"), default="tuning")
    parser.add_argument("--seed", type=int, action="append", help="instead of the usual ones; repeatable")
    parser.add_argument("--only", default="", help="those whose name contains this")
    chosen = parser.parse_args(arguments)
    for spec in suite(chosen.suite, chosen.seed):
        if chosen.only in spec.name:
            sequence = load(make(spec, chosen.out))
            low, middle, high = 100 * np.quantile(sequence.occlusion, (0.1, 0.5, 0.9))
            print(
                f"{spec.name}: {spec.frames} frames, occlusion {low:.0f} / {middle:.0f} / {high:.0f} %",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())

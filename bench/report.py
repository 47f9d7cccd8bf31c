"""Collects results of finished runs into bench/results, or draws the learning curves of runs.

python -m bench.report --collect DIR [DIR ...]
python -m bench.report --run DIR [DIR ...] --out curve.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bench.collect import collect
from bench.run_curves import draw_runs


def main() -> None:
    """Parse the command line; collect or draw."""
    arguments = _arguments()
    try:
        if arguments.collect:
            print("\n".join(collect(arguments.collect, arguments.unfinished)))
        if arguments.run:
            draw_runs(arguments.run, arguments.out)
            print(arguments.out)
    except OSError as error:
        sys.exit(f"bench.report: {error}")


def _arguments() -> argparse.Namespace:
    about = (__doc__ or "").split("\n\n", maxsplit=1)[0]
    parser = argparse.ArgumentParser(prog="python -m bench.report", description=about)
    parser.add_argument(
        "--collect", type=Path, nargs="+", action="extend", metavar="DIR", help="runs, or folders of runs"
    )
    parser.add_argument("--unfinished", action="store_true", help="collect unfinished runs, too")
    parser.add_argument("--run", type=Path, nargs="+", action="extend", metavar="DIR")
    parser.add_argument("--out", type=Path, default=Path("curve.png"), help="of --run")
    return parser.parse_args()


if __name__ == "__main__":
    main()

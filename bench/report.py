"""Draws and writes the results from the committed rows, or brings runs' rows there.

python -m bench.report                                   # docs/results from bench/results/*.jsonl
python -m bench.report --collect DIR [DIR ...]           # finished runs' rows into bench/results
python -m bench.report --run DIR [DIR ...] --out curve.png
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from bench.collect import collect, committed_rows
from bench.figures import CURVES_FILE, STEPS_FILE, SUCCESS_FILE, digest_of, draw_figures
from bench.outcomes import outcomes
from bench.pages import headline, page
from bench.references import RESULTS, best
from bench.run_curves import draw_runs
from bench.stated import TASKS
from bench.summary import json_lines, result_of
from deploy.scores import Row
from deploy.supervisor import REPOSITORY

PAGE_FILE = "README.md"
PICTURES = (CURVES_FILE, SUCCESS_FILE, STEPS_FILE)
_HEADLINE = re.compile(r"(<!-- result:headline -->\n).*?(<!-- /result:headline -->)", re.DOTALL)


@dataclass(frozen=True)
class Places:
    """Where the rows are, where the page and pictures go, and which document shows the headline."""

    results: Path = RESULTS
    pages: Path = REPOSITORY / "docs" / "results"
    readme: Path = REPOSITORY / "README.md"


def outdated(places: Places) -> list[Path]:
    """What is not as the committed rows have it."""
    stale = [
        path for path, text in _texts(places).items() if not path.exists() or path.read_text("utf-8") != text
    ]
    pictures = (places.pages / name for name in PICTURES)
    return stale + [path for path in pictures if digest_of(path) != _digest(places.results)]


def rewrite(places: Places) -> list[Path]:
    """Write the documents, and the pictures if they show other rows; returns what has changed."""
    stale, texts = outdated(places), _texts(places)
    places.pages.mkdir(parents=True, exist_ok=True)
    for path in stale:
        if path in texts:
            path.write_text(texts[path], encoding="utf-8")
    if any(path.suffix == ".png" for path in stale):
        draw(places)
    return stale


def draw(places: Places) -> None:
    """Draw all pictures."""
    ceilings = _ceilings(places.results)
    rates = {task: result_of(rows)["success_paper"]["rate"] for task, rows in ceilings.items()}
    draw_figures(outcomes(committed_rows(places.results)), rates, _digest(places.results), places.pages)


def _texts(places: Places) -> dict[Path, str]:
    """What each document should hold."""
    found, ceilings = outcomes(committed_rows(places.results)), _ceilings(places.results)
    readme = places.readme.read_text(encoding="utf-8")
    table = headline(found, ceilings)
    case_studies = sorted(path.name for path in places.pages.glob("case_study_*.md"))
    return {
        places.pages / PAGE_FILE: page(found, ceilings, case_studies),
        places.readme: _HEADLINE.sub(lambda marks: f"{marks[1]}{table}{marks[2]}", readme),
    }


def _ceilings(results: Path) -> dict[str, list[Row]]:
    found = {task: json_lines(results / f"ceiling_{task}.jsonl") for task in TASKS}
    return {task: best(rows) for task, rows in found.items() if rows}


def _digest(results: Path) -> str:
    text = json.dumps([committed_rows(results), _ceilings(results)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def main() -> None:
    """Parse the command line; collect, draw runs, check or write the results."""
    arguments, places = _arguments(), Places()
    try:
        if arguments.collect:
            print("\n".join(collect(arguments.collect, arguments.unfinished)))
        elif arguments.run:
            draw_runs(arguments.run, arguments.out)
            print(arguments.out)
        elif arguments.check:
            stale = ", ".join(str(path.relative_to(REPOSITORY)) for path in outdated(places))
            sys.exit(f"out of date, run `python -m bench.report`: {stale}" if stale else 0)
        else:
            print("\n".join(f"{path}: rewritten" for path in rewrite(places)) or "nothing has changed")
    except OSError as error:
        sys.exit(f"bench.report: {error}")


def _arguments() -> argparse.Namespace:
    about = (__doc__ or "").split("\n\n", maxsplit=1)[0]
    parser = argparse.ArgumentParser(prog="python -m bench.report", description=about)
    parser.add_argument(
        "--collect", type=Path, nargs="+", action="extend", metavar="DIR", help="runs, or folders of runs"
    )
    parser.add_argument("--unfinished", action="store_true", help="collect unfinished runs, too")
    parser.add_argument(
        "--run", type=Path, nargs="+", action="extend", metavar="DIR", help="draw the curves of these alone"
    )
    parser.add_argument("--out", type=Path, default=Path("curve.png"), help="picture of --run")
    parser.add_argument(
        "--check", action="store_true", help="change nothing; fail if anything is out of date"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()

"""Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable

Row = tuple[str, ...]


def table(headings: Row, rows: Iterable[Row]) -> str:
    """Lay rows out in Markdown."""
    lines = [headings, ("---",) * len(headings), *rows]
    return "".join("| " + " | ".join(_cell(text) for text in line) + " |\n" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def code(text: str) -> str:
    """Set as code; nothing when there is nothing."""
    return f"`{text}`" if text else ""

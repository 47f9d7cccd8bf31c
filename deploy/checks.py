"""One line of what the doctor finds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One line of the report."""

    ok: bool
    about: str
    found: str
    advice: str = ""

    def __str__(self) -> str:
        """Lay the line out."""
        advice = "" if self.ok or not self.advice else f" -> {self.advice}"
        return f"{'ok  ' if self.ok else 'FAIL'}  {self.about:24}{self.found}{advice}"

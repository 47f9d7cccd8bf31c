"""Plots of the dashboard, of the last steps or of the whole run."""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun.blueprint as rrb

RECENT_STEPS = 250  # five episodes of the simulated tasks
RECENT_S = 90.0
_relative = rrb.TimeRangeBoundary.cursor_relative
_FROM, _TO = _relative(seconds=-RECENT_S), _relative(seconds=0.0)
_SECONDS = rr.VisibleTimeRange("time", start=_FROM, end=_TO)


def recent(name: str, *paths: str, legend: bool = True) -> rrb.TimeSeriesView:
    """A plot of the last steps."""
    steps = rr.VisibleTimeRange("step", start=_relative(seq=-RECENT_STEPS), end=_relative(seq=0))
    return _plot(name, paths, legend, time_ranges=[steps, _SECONDS])


def recent_seconds(name: str, *paths: str, legend: bool = True) -> rrb.TimeSeriesView:
    """A plot of the last seconds, for the axis `time` alone; without a range it would look ahead as well."""
    shown = rrb.TimeAxis(view_range=rr.TimeRange(start=_FROM, end=_TO))
    return _plot(name, paths, legend, time_ranges=[_SECONDS], axis_x=shown)


def whole(name: str, *paths: str) -> rrb.TimeSeriesView:
    """A plot of the whole run."""
    return _plot(name, paths, legend=True)


def _plot(name: str, paths: tuple[str, ...], legend: bool, **options: Any) -> rrb.TimeSeriesView:
    contents = [f"+ /{path}" for path in paths]
    shown = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend)
    return rrb.TimeSeriesView(name=name, contents=contents, plot_legend=shown, **options)

"""The dashboard's page about a DexHand: the hand in space, its joints, fingertips, motors and boards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rerun.blueprint as rrb

from deploy.viewer.hand_curves import BOARD_NAMES, motors_of
from deploy.viewer.views import recent, recent_seconds

Plot = Callable[..., rrb.TimeSeriesView]
_COLUMNS = 2  # of the joints' plots


def hand_page(scene: Any, driven: bool) -> rrb.Horizontal:
    """Scene, goal and fingertips; joints; and, of a hand that is `driven` over a bus, motors and boards."""
    plot: Plot = recent_seconds if driven else recent
    forces = plot("Fingertip normal forces, N", "hand/force_n/**")
    turn = plot("Angle to the goal, rad", "goal/error_rad")
    parts: list[Any] = [rrb.Vertical(scene, forces, turn, row_shares=[3, 1.2, 1.2]), _joints(plot)]
    if driven:
        parts.append(_boards(plot))
    return rrb.Horizontal(*parts, column_shares=[5, 5, 3][: len(parts)], name="Hand")


def _joints(plot: Plot) -> rrb.Grid:
    """A plot for each board's two motors: where the joint is (bright) and where it should be (dim)."""
    plots = [
        plot(f"{name.capitalize()}: angle and target, rad", *_angle_paths(board))
        for board, name in enumerate(BOARD_NAMES)
    ]
    return rrb.Grid(*plots, grid_columns=_COLUMNS)


def _angle_paths(board: int) -> list[str]:
    return [f"hand/angle_rad/{joint}" for joint in motors_of(board)]


def _boards(plot: Plot) -> rrb.Vertical:
    return rrb.Vertical(
        plot("Motor currents, mA", "hand/current_ma/**", legend=False),
        plot("Board temperatures, °C", "hand/temperature_c/**"),
        plot("Age of each board's last reply, ms", "hand/age_ms/**"),
        plot("Replies of each board a second", "hand/rate_hz/**"),
    )

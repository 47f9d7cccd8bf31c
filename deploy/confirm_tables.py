"""The table of all that nobody has measured on a real DexHand: to be confirmed before it first has power."""

from __future__ import annotations

import types
from collections.abc import Mapping

import common.dexhand021.config as hand
import common.dexhand021.glove_config as glove
import services.hand_io.config as hand_io
import services.hand_io.limits_config as limits
import services.sim.dexhand_physics as twin
import services.sim.emulator_config as emulator
from common.dexhand021.config import Confirm
from deploy.markdown import Row, code, table

# By the section of a cell that holds the options; in the order in which people need to know.
ASSUMPTIONS: Mapping[str, tuple[Confirm, ...]] = types.MappingProxyType(
    {
        "hand": hand.CONFIRM_ON_HARDWARE,
        "hand_io.limits": limits.CONFIRM_ON_HARDWARE,
        "hand_io": hand_io.CONFIRM_ON_HARDWARE,
        "emulator": emulator.CONFIRM_ON_HARDWARE,
        "twin": twin.CONFIRM_ON_HARDWARE,
        "glove": glove.CONFIRM_ON_HARDWARE,
    }
)


def confirm() -> str:
    """One row per assumption: those without an option say what is done instead."""
    rows = (_row(section, each) for section, some in ASSUMPTIONS.items() for each in some)
    return table(("option", "assumed", "why", "how to confirm"), rows)


def _row(section: str, each: Confirm) -> Row:
    if not each.field:
        return "–", each.default, each.why, each.how
    return code(f"{section}.{each.field}"), code(each.default), each.why, each.how

"""Nothing that is not public about the hand is assumed without being said, with its true default."""

from functools import reduce

import pytest

from common.dexhand021.config import DexHandConfig
from deploy.cell import Cell
from deploy.confirm_tables import ASSUMPTIONS, confirm
from services.sim.dexhand_physics import TwinPhysics

ROWS = [(section, each) for section, some in ASSUMPTIONS.items() for each in some]
OPTIONS = {f"{section}.{each.field}" for section, each in ROWS if each.field}
REST = [each.why for _, each in ROWS if not each.field]
# What no public source tells (see common/dexhand021/tables.py for the sources), and the options it decides.
NOT_PUBLIC = {
    "control mode's stiffness": {"hand.mode"},
    "broadcast known to the firmware": {"hand.motion"},
    "force without a limit of current": {"hand.accept_no_current_limit"},
    "bit rate switch of the replies": {"hand.bit_rate_switch"},
    "length of the replies": {"hand.feedback_bytes", "emulator.feedback_bytes"},
    "scaling of the speed field": {"hand.speed"},
    "unit of the current field": {"hand.current", "hand_io.limits.max_current"},
    "list of firmwares": {"emulator.firmware"},
    "what the temperature is that of": {"hand_io.limits.hand_limit_c", "hand_io.limits.pause_c"},
    "joint of the distal sensor": {"hand.distal_sensor"},
    "highest command rate": {"hand_io.set_point_hz"},
    "ratio of the coupled joints": {"hand.distal_ratio"},
    "spread": {"hand.spread_ratios", "hand.signs", "hand_io.limits.clearance_m"},
    "joint torque": {"twin.torque_nm", "twin.stiffness_nm_rad", "twin.damping_nms_rad"},
    "joint friction": {"twin.friction_nms_rad"},
    "motors": {"twin.armature_kgm2", "twin.current_ma_nm"},
    "speed limits": {"hand_io.limits.rate_rad_s", "twin.rate_rad_s"},
    "start-up frame": {"hand.startup_frame", "emulator.startup_bytes"},
    "what silence leads to": {"emulator.silence_s"},
    "glove": {"glove.unit", "glove.names", "glove.sources"},
    "die": {"twin.die_mass_kg", "twin.finger_friction", "twin.palm_friction"},
}


def test_the_table_is_complete_and_has_nothing_else():
    assert set().union(*NOT_PUBLIC.values()) == OPTIONS
    assert len(ROWS) == len(OPTIONS) + len(REST)
    for topic in ("mounted", "newest SDK reads 3", "code 1", "flexion 90 or 74.5", "twelve motors"):
        known = [row for _, row in ROWS if not row.field and topic in f"{row.default} {row.why}"]
        assert len(known) == 1, topic
    assert len(REST) == 5


@pytest.mark.parametrize(("section", "row"), ROWS)
def test_each_row_states_the_true_default_why_and_how(section, row):
    assert row.why and row.how and row.default
    if row.field:
        assert str(reduce(getattr, [*section.split("."), row.field], Cell())) == row.default


def test_every_option_about_the_unknown_hand_is_in_the_table():
    told = {option.removeprefix("hand.") for option in OPTIONS if option.startswith("hand.")}
    assert told == set(DexHandConfig.model_fields) - {"hand"}
    ours = {"timestep_s", "set_point_hz", "table_m"}  # of the simulation, not of a hand
    physics = {option.removeprefix("twin.") for option in OPTIONS if option.startswith("twin.")}
    assert physics == set(TwinPhysics.model_fields) - ours


def test_a_row_reads_well():
    lines = confirm().splitlines()
    assert len(lines) == 2 + len(ROWS)
    assert any(
        line.startswith("| `hand.distal_sensor` | `pip` | one motor bends PIP and DIP;") for line in lines
    )
    assert sum(line.startswith("| – | ") for line in lines) == len(REST)

from dataclasses import replace

import pytest

from common.messages import Health
from deploy.cell import load_cell
from deploy.doctor import expected_processes, own_version, process_checks
from deploy.monitor import Heard

NAME = "watchdog_learning"
HASH = "abc"
HEALTH = Health(
    service=NAME,
    state="watching",
    loop_p50_ms=1.0,
    loop_p99_ms=2.0,
    ticks=10,
    overruns=0,
    stale_inputs=(),
    refused={},
    dropped={},
    config_hash=HASH,
    version=own_version(),
    rss_mb=50.0,
)


def judged(heard: Heard | None, *tokens: str) -> list[tuple[bool, str, str]]:
    found = process_checks(NAME, tokens, heard, (HASH,))
    return [(check.ok, check.about, check.found) for check in found]


def test_each_machine_s_watchdog_is_expected_by_the_name_that_it_has_on_the_bus() -> None:
    names = expected_processes(load_cell("three_machines"))
    assert [name for name in names if name.startswith("watchdog")] == [
        "watchdog_control",
        "watchdog_learning",
        "watchdog_perception",
    ]


def test_a_healthy_watchdog_of_one_machine_is_in_order() -> None:
    assert judged(Heard(HEALTH, 0.2, 1), NAME) == [(True, NAME, "watching, heard 0.2 s ago")]


@pytest.mark.parametrize("tokens", [(), ("watchdog",), ("watchdog_control",)])
def test_that_of_another_machine_does_not_stand_in(tokens: tuple[str, ...]) -> None:
    assert judged(Heard(HEALTH, 0.2, 1), *tokens) == [(False, NAME, "not on the bus")]


def test_silence_and_differences_are_told() -> None:
    assert judged(None, NAME) == [(False, NAME, "exists but is not heard")]
    assert judged(Heard(HEALTH, 7.0, 1), NAME) == [(False, NAME, "silent for 7.0 s")]
    other = Heard(replace(HEALTH, version="0", config_hash="xyz"), 0.2, 1)
    assert [(ok, about) for ok, about, _ in judged(other, NAME)] == [
        (True, NAME),
        (False, f"{NAME} version"),
        (False, f"{NAME} config"),
    ]

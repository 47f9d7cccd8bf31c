from pathlib import Path

from common.messages import Health
from deploy.monitor import Heard
from deploy.status import restarts, rows, table
from deploy.supervisor_client import ProcessInfo


def heard(name: str, age_s: float = 0.2, config_hash: str = "abc") -> Heard:
    health = Health(
        service=name,
        state="working",
        loop_p50_ms=1.0,
        loop_p99_ms=2.5,
        ticks=10,
        overruns=3,
        stale_inputs=("control/step",),
        refused={"control/chunk": 2, "control/step": 1},
        dropped={"control/step": 4},
        config_hash=config_hash,
        version="0.1.0",
        rss_mb=123.4,
    )
    return Heard(health, age_s, 1)


def info(name: str, state: str = "RUNNING", reason: str = "") -> ProcessInfo:
    return ProcessInfo(name, state, 1, 0, 10.0, reason)


def problems(*found: tuple[str, ProcessInfo | None, Heard | None]) -> list[str]:
    infos = {name: known for name, known, _ in found if known}
    health = {name: sample for name, _, sample in found if sample}
    return [
        row.problem
        for row in rows([name for name, *_ in found], infos, health, "abc", restarts(Path("none")))
    ]


def test_a_row_shows_what_the_heartbeat_says() -> None:
    (row,) = rows(["sim"], {"sim": info("sim")}, {"sim": heard("sim")}, "abc", {"sim": 2})
    expected = ("sim", "running", "working", "0.2", "1.0/2.5", "3", "control/step", "3", "4", "2", "123", "")
    assert row.cells == expected
    assert table([row]).splitlines()[1].split() == [text for text in expected if text]


def test_problems_are_named() -> None:
    found = problems(
        ("router", info("router"), None),
        ("sim", info("sim"), heard("sim", age_s=7.0)),
        ("planner", info("planner"), heard("planner", config_hash="xyz")),
        ("learner", info("learner", "FATAL", "Exited too quickly"), None),
        ("viewer", info("viewer"), None),
        ("curriculum", info("curriculum", "EXITED"), None),
    )
    assert found == [
        "",
        "SILENT for 7 s",
        "OTHER CONFIG xyz",
        "NOT RUNNING (Exited too quickly)",
        "NOT HEARD",
        "",
    ]


def test_processes_of_other_machines_are_judged_by_what_is_heard() -> None:
    assert problems(("sim", None, heard("sim")), ("planner", None, None)) == ["", "NOT HEARD"]


def test_restarts_are_counted_since_supervisord_began(tmp_path: Path) -> None:
    log = tmp_path / "supervisord.log"
    log.write_text(
        "INFO spawned: 'sim' with pid 3\nINFO supervisord started with pid 9\n"
        "INFO spawned: 'sim' with pid 10\nINFO spawned: 'planner' with pid 11\n"
        "INFO spawned: 'sim' with pid 12\n",
        encoding="utf-8",
    )
    assert restarts(log) == {"sim": 1, "planner": 0}

"""The documents agree with the code: tables are up to date, and what they name exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from common.built import new_boot_id
from common.cell import SharedConfig
from common.task import get_task
from deploy import tables
from deploy.config_tables import sections
from deploy.curriculum import CurriculumProcess
from deploy.curriculum import build as build_curriculum
from deploy.supervisor import REPOSITORY
from deploy.tables import TABLES, TablesError, documents, main, outdated, rewritten
from services.learner.build import LearnerProcess
from services.learner.build import build as build_learner
from services.planner.build import PlannerProcess
from services.planner.build import build as build_planner
from services.sim.service import SimService

PAPER_MAP = REPOSITORY / "docs" / "paper_map.md"
OPERATING = REPOSITORY / "docs" / "guides" / "operating.md"
TUNING = REPOSITORY / "docs" / "guides" / "tuning.md"
# A file in code marks, with `:name` for what it defines and `::name` for a test.
NAMED = re.compile(r"`((?:common|services|deploy|bench|tests)/[\w./]+\.(?:py|yaml|sh))(?:::?([\w.]+))?`")
LINK = re.compile(r"\]\(([^)#:]+)(?:#([\w-]+))?\)")
SUPPLIED = {"images/dashboard.png"}  # a picture of a run, which no test can make


def test_the_documents_are_up_to_date():
    stale = [str(path.relative_to(REPOSITORY)) for path in outdated()]
    assert not stale, f"run `python -m deploy.tables`: {', '.join(stale)}"


def test_every_table_stands_in_a_document():
    text = "".join(path.read_text(encoding="utf-8") for path in documents())
    assert [name for name in TABLES if f"<!-- table:{name} -->" not in text] == []
    assert all(f"table:config:{name}" in TUNING.read_text(encoding="utf-8") for name in sections())


def test_a_table_is_replaced_and_the_rest_stays():
    old = "before\n<!-- table:presets -->\nstale\n<!-- /table:presets -->\nafter\n"
    new = rewritten(old, "x.md")
    assert new.startswith("before\n<!-- table:presets -->\n| key |")
    assert new.endswith("|\n<!-- /table:presets -->\nafter\n")
    assert rewritten(new, "x.md") == new


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("<!-- table:nothing -->\n<!-- /table:nothing -->", "x.md: no table nothing"),
        ("<!-- table:topics -->\n", "x.md: a table's begin or end is missing"),
    ],
)
def test_a_broken_document_is_one_line(text, complaint):
    with pytest.raises(TablesError, match=complaint):
        rewritten(text, "x.md")


def test_checking_changes_nothing_and_rewriting_does(tmp_path: Path, monkeypatch, capsys):
    page = tmp_path / "README.md"
    page.write_text("<!-- table:presets -->\n<!-- /table:presets -->\n", encoding="utf-8")
    monkeypatch.setattr(tables, "REPOSITORY", tmp_path)
    assert main(["--check"]) == 1
    assert page.read_text(encoding="utf-8").count("\n") == 2
    assert main([]) == 0
    assert main(["--check"]) == 0
    assert capsys.readouterr().out == "README.md: out of date\nREADME.md: rewritten\n"


@pytest.mark.parametrize("page", documents(), ids=lambda path: path.name)
def test_what_a_document_names_exists(page: Path):
    missing = [f"{path} {name}" for path, name in NAMED.findall(page.read_text()) if not _exists(path, name)]
    assert missing == []


def _exists(path: str, name: str) -> bool:
    file = REPOSITORY / path
    return file.is_file() and all(_defines(file.read_text(), part) for part in name.split(".") if part)


def _defines(text: str, name: str) -> bool:
    return re.search(rf"^\s*(?:def|class) {name}\b|^{name}\b.*=", text, re.MULTILINE) is not None


@pytest.mark.parametrize("page", documents(), ids=lambda path: path.name)
def test_links_lead_somewhere(page: Path):
    for target, anchor in LINK.findall(page.read_text()):
        file = (page.parent / target).resolve()
        if any(str(file).endswith(name) for name in SUPPLIED):
            continue
        assert file.exists(), target
        assert not anchor or anchor in _anchors(file.read_text()), f"{target}#{anchor}"


def _anchors(text: str) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_each_deviation_marked_in_the_code_stands_in_the_paper_map():
    text = PAPER_MAP.read_text()
    folders = ("common", "services", "deploy", "bench")
    marked = [
        p for folder in folders for p in (REPOSITORY / folder).rglob("*.py") if "# Paper:" in p.read_text()
    ]
    assert marked
    assert [
        str(p.relative_to(REPOSITORY)) for p in marked if str(p.relative_to(REPOSITORY)) not in text
    ] == []


def test_every_row_of_the_paper_map_has_its_five_columns():
    rows = [line for line in PAPER_MAP.read_text().splitlines() if line.startswith("|")]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {6}


def test_every_counter_is_explained(tmp_path: Path):
    shared = {"run_dir": tmp_path}
    services = (
        SimService(SharedConfig(), get_task("reach"), new_boot_id()),
        build_planner(PlannerProcess(**shared), new_boot_id()).service,
        build_learner(
            LearnerProcess.model_validate({**shared, "model": {"members": 1}}), new_boot_id()
        ).service,
        build_curriculum(CurriculumProcess(**shared), new_boot_id()).service,
    )
    text = OPERATING.read_text()
    counters = {name for service in services for name in service.report().fields}
    assert sorted(name for name in counters if f"`{name}`" not in text) == []


def test_guides_stay_short():
    for page in (OPERATING, TUNING):
        written = re.sub(r"<!-- table:.*?<!-- /table", "", page.read_text(), flags=re.DOTALL)
        assert written.count("\n") < 250

from pathlib import Path

import pytest

from common.config import ConfigError
from deploy.cell import load_cell
from deploy.cell_files import find_cell, read_cell

BASE = "cell: under\nseed: 3\nplanner:\n  preset: fast\n  smooth_groups: [qpos, object_position]\n"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def refusal(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(ConfigError) as error:
        read_cell(path, overrides)
    return error.value.lines


def test_sections_are_merged_and_other_values_replaced(tmp_path: Path) -> None:
    write(tmp_path / "under.yaml", BASE)
    path = write(
        tmp_path / "over.yaml",
        "cell: over\nbase: under.yaml\nplanner:\n  smooth_groups: [qpos]\nmodel:\n  members: 3\n",
    )
    assert read_cell(path, ["seed=4"]) == {
        "cell": "over",
        "seed": 4,
        "planner": {"preset": "fast", "smooth_groups": ["qpos"]},
        "model": {"members": 3},
    }


def test_an_override_replaces_a_whole_section_of_the_base_too(tmp_path: Path) -> None:
    write(tmp_path / "under.yaml", BASE)
    path = write(tmp_path / "over.yaml", "base: under.yaml\n")
    assert read_cell(path, ["planner={preset: paper}"])["planner"] == {"preset": "paper"}


def test_the_hash_is_that_of_the_effective_cell(tmp_path: Path) -> None:
    short = write(tmp_path / "short.yaml", "cell: own\nbase: reach\n")
    text = find_cell("reach").read_text(encoding="utf-8").replace("cell: reach", "cell: own")
    whole = load_cell(str(write(tmp_path / "whole.yaml", text)))
    assert load_cell(str(short)).config_hash == whole.config_hash
    assert "base" not in whole.model_dump(mode="json")


def test_three_machines_run_reach_as_one_does() -> None:
    one, three = load_cell("reach"), load_cell("three_machines")
    for section in ("task", "control", "model", "planner", "learner", "curriculum"):
        assert getattr(three, section) == getattr(one, section)
    assert set(three.machines) == {"control", "learning", "perception"}


def test_a_base_that_leads_back_is_refused_in_one_line(tmp_path: Path) -> None:
    first = write(tmp_path / "a.yaml", "base: b.yaml\n")
    write(tmp_path / "b.yaml", "base: a.yaml\n")
    assert refusal(first) == ["b.yaml: base: goes round in a circle: a.yaml -> b.yaml -> a.yaml"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("base: raech\n", "x.yaml: base: raech: no such cell; give a file, or one of: block debug"),
        ("base: 3\n", "x.yaml: base: must name a cell or a file (given: 3)"),
        ("base:\n", "x.yaml: base: must name a cell or a file (given: None)"),
    ],
)
def test_a_base_that_is_none_is_refused_in_one_line(tmp_path: Path, text: str, complaint: str) -> None:
    (line,) = refusal(write(tmp_path / "x.yaml", text))
    assert line.startswith(complaint)


def test_a_base_cannot_be_given_for_one_start() -> None:
    (line,) = refusal(find_cell("reach"), "base=egg")
    assert line.startswith("--set base: ")

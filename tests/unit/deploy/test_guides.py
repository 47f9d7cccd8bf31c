"""What the documents tell people to write into a file can be loaded, and options take values they name."""

import re
from pathlib import Path

import pytest

from common.config import ConfigError, parse, read_yaml
from common.hand_messages import PoseSource
from deploy.cell import Cell, instances_of, load_cell
from deploy.cell_files import find_cell, read_cell
from deploy.supervisor import REPOSITORY
from deploy.tables import documents
from services.perception.rig import RigConfig

BLOCK = re.compile(r"^( *)```yaml\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
OPTION = re.compile(r"`([a-z_][a-z_.]*): ([\w.-]+)`")


def blocks(page: Path) -> list[str]:
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return ["".join(line[len(indent) :] for line in text.splitlines(True)) for indent, text in found]


BLOCKS = [(page.name, text) for page in documents() for text in blocks(page)]


@pytest.mark.parametrize(("page", "text"), BLOCKS, ids=[name for name, _ in BLOCKS])
def test_every_yaml_of_the_documents_can_be_loaded(page, text, tmp_path):
    file = tmp_path / "written.yaml"
    file.write_text(text, encoding="utf-8")
    if text.startswith("# rig.yaml"):
        assert parse(RigConfig, read_yaml(file), page)
    else:
        assert load_cell(str(file)).run_dir


def test_the_cell_of_a_real_hand_is_one(tmp_path):
    (text,) = blocks(REPOSITORY / "docs" / "guides" / "dexhand.md")
    file = tmp_path / "my_hand.yaml"
    file.write_text(text, encoding="utf-8")
    cell = load_cell(str(file))
    assert (cell.plant, cell.pose_source) == ("hand", PoseSource.PERCEPTION)
    assert not cell.can.simulated and not cell.hand_io.auto_arm
    names = set(instances_of(cell, "local"))
    assert {"hand_io", "perception"} < names and not {"emulator", "camera", "sim"} & names
    assert cell.perception.source.kind == "realsense" and cell.perception.calibration is not None


@pytest.mark.parametrize("page", documents(), ids=lambda path: path.name)
def test_options_that_a_document_names_take_that_value(page):
    wrong = []
    for key, value in OPTION.findall(page.read_text(encoding="utf-8")):
        try:
            if key != "base" and key.partition(".")[0] in Cell.model_fields:
                parse(Cell, read_cell(find_cell("dexhand_twin"), [f"{key}={value}"]), page.name)
        except ConfigError as error:
            wrong += error.lines
    assert wrong == []

"""`python -m deploy.glove`: makes recordings, fits a person, and says what recordings hold."""

import pytest

from common.config import ConfigError, load
from common.dexhand021.glove_config import GloveUser
from common.dexhand021.glove_fit import POSTURES
from deploy.cell import load_cell, process_config
from deploy.glove import main
from deploy.launch import Launch
from deploy.supervisor import REPOSITORY
from services.hand_io.build import build as build_hand_io
from services.hand_io.config import HandIoProcess
from services.sim.build import SimProcess
from services.sim.build import build as build_sim
from services.sim.glove_writers import FORMATS

SMALL = ("--demonstrations", "2", "--steps", "7", "--candidates", "1", "--seed", "3")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Recordings of one made-up person in each format, and the fit from its CSV postures."""
    folder = tmp_path_factory.mktemp("glove")
    for form in FORMATS:
        assert main(["make", str(folder / form), "--format", form, *SMALL]) == 0
    assert main(["fit", str(folder / "csv" / "postures"), "--out", str(folder / "user.yaml")]) == 0
    return folder


FILES = {"csv": "*.csv", "jsonl": "*.jsonl", "hdf5": "*.h5", "mcap": "*.mcap", "lerobot": ""}


@pytest.mark.parametrize("form", FORMATS)
def test_what_it_makes_it_reads(made, capsys, form):
    assert sorted(path.stem for path in (made / form / "postures").iterdir()) == sorted(POSTURES)
    assert main(["check", str(made / form / FILES[form]), "--user", str(made / "user.yaml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(": ")[2][:16] for line in lines] == ["7 actions at 3 Hz"[:16]] * 2 + ["14 actions"]


def test_a_fit_is_written_and_printed_motor_by_motor(made, capsys):
    assert main(["fit", str(made / "mcap" / "postures"), "--out", str(made / "again.yaml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 12 + 1 and lines[1].startswith("th_dip ")
    assert load(GloveUser, made / "again.yaml") == load(GloveUser, made / "user.yaml")


def test_what_the_hand_cannot_reach_is_told(made, capsys, tmp_path):
    user = tmp_path / "user.yaml"
    user.write_text("offset_deg: [0, 0, 0, 0, 0, 90, 0, 0, 0, 0, 0, 0]\n")
    assert main(["check", str(made / "csv" / "*000.csv"), "--user", str(user)]) == 0
    assert (
        "demonstration_000.csv: 7 actions at 3 Hz; beyond reach: ff_mcp in 100%\n" in capsys.readouterr().out
    )


def test_mistakes_are_told_in_one_line(made, capsys, tmp_path):
    mistakes = {
        ("check",): "glove: check: name recordings, or a cell with --cell",
        ("check", "--cell", "die"): "glove: die: has no recordings (glove.sources)",
        ("check", "no.csv"): "glove: no.csv: cannot be read (No such file or directory)",
        ("fit", str(tmp_path), "--out", "x"): (
            f"glove: {tmp_path}: there is no recording of the posture flat (flat.csv, ...)"
        ),
        ("make", str(tmp_path), "--candidates", "0"): "glove: candidates must be at least 1, got 0",
    }
    for arguments, told in mistakes.items():
        assert main(arguments) == 1
        assert capsys.readouterr().err == f"{told}\n"


def test_a_cell_does_not_start_with_a_bad_recording(made, tmp_path):
    bad = tmp_path / "bad.csv"
    text = (made / "csv" / "demonstration_000.csv").read_text()
    bad.write_text(text.replace("Ring_PIP_Flex", "Ring"))
    overrides = ["curriculum.warmup=glove", f"glove.sources=[{{files: [{bad}]}}]", f"run_dir={tmp_path}/run"]
    with pytest.raises(ConfigError) as refused:
        Launch(load_cell("die", overrides)).start()
    assert refused.value.lines == ["bad.csv: there is no column Ring_PIP_Flex"]
    assert not (tmp_path / "run").exists()


def test_the_recordings_of_a_cell_are_checked_as_it_reads_them(made, capsys):
    files = f"glove.sources=[{{files: [{made}/jsonl/*.jsonl], user: {made}/user.yaml}}]"
    assert main(["check", "--cell", "die", "--set", files, "--set", "control.rate_hz=6"]) == 0
    assert capsys.readouterr().out.endswith("in all: 26 actions\n")


@pytest.mark.parametrize(
    ("cell", "process", "build"),
    [
        ("die", SimProcess, build_sim),
        ("dexhand_twin", HandIoProcess, build_hand_io),
    ],
)
def test_the_plants_of_both_cells_have_the_recordings(made, cell, process, build):
    files = f"glove.sources=[{{files: [{made}/csv/*.csv], user: {made}/user.yaml}}]"
    effective = load_cell(cell, ["curriculum.warmup=glove", files])
    name = "sim" if cell == "die" else "hand_io"
    built = build(process.model_validate(process_config(effective, name)), 1)
    assert built.service.report().fields["glove_samples"] == 14


def test_a_cells_relative_files_are_meant_from_the_project_and_its_digest_knows_no_places():
    there, here = (
        load_cell("die", [f"glove.sources=[{{files: [{folder}a.csv]}}]"]) for folder in ("", "/else/")
    )
    assert there.glove.sources[0].files == (str(REPOSITORY / "a.csv"),)
    assert here.glove.sources[0].files == ("/else/a.csv",)
    assert there.config_hash == here.config_hash == there.hash() != load_cell("die").config_hash

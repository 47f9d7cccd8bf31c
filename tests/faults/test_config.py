"""A cell file with mistakes starts nothing and names each of them in a line."""

import subprocess
import sys

import pytest

from deploy.supervisor import REPOSITORY

pytestmark = pytest.mark.processes

MISTAKES = """\
cell: debug
planner:
  horizont: 5
learner:
  batch: many
control:
  rate_hz: -25
"""
COMPLAINTS = (
    "wrong.yaml: control.rate_hz: input should be greater than 0 (given: -25)",
    "wrong.yaml: learner.batch: input should be a valid integer",
    "wrong.yaml: planner.horizont: no such key",
)


@pytest.mark.parametrize("command", ["run", "up", "status"])
def test_a_typo_a_wrong_type_and_a_value_out_of_range_are_three_lines(tmp_path, command):
    file = tmp_path / "wrong.yaml"
    file.write_text(f"{MISTAKES}run_dir: {tmp_path / 'run'}\n")
    words = [sys.executable, "-m", "deploy.main", "--config", str(file), command]
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    lines = sorted(done.stderr.splitlines())
    assert len(lines) == 3, done.stderr
    for line, complaint in zip(lines, COMPLAINTS, strict=True):
        assert line.startswith(complaint)
    assert not (tmp_path / "run").exists()

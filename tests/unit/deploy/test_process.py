"""A process that cannot be built says so in one line, and with an exit code of its own."""

import os
import sys
from pathlib import Path

import pytest

from common.built import Built
from common.cell import SharedConfig
from common.config import ConfigError
from common.process import run_process


def leave(code: int) -> None:
    raise SystemExit(code)


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            ValueError("loss.group_weights: reach has no\n  group tip"),
            "learner: loss.group_weights: reach has no group tip",
        ),
        (ConfigError(["seed: is odd"]), "seed: is odd"),
    ],
)
def test_what_a_build_refuses_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    told: str,
) -> None:
    config = tmp_path / "learner.yaml"
    config.write_text("cell: debug\n", encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["learner", "--config", str(config)])
    monkeypatch.setattr(os, "_exit", leave)

    def build(_config: SharedConfig, _boot_id: int) -> Built:
        raise error

    with pytest.raises(SystemExit) as left:
        run_process("learner", SharedConfig, build)
    assert left.value.code == 2
    assert capsys.readouterr().err == f"{told}\n"

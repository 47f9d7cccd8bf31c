import pytest

from deploy.arguments import Arguments, UsageError, parse
from deploy.main import main


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("", Arguments()),
        ("status", Arguments("status")),
        ("--config debug", Arguments(cell="debug")),
        ("--config=debug up", Arguments("up", cell="debug")),
        ("learning up --config x.yaml", Arguments("up", machine="learning", cell="x.yaml")),
        ("learning", Arguments(machine="learning")),
        ("--set a.b=1 run --set c=2", Arguments(overrides=("a.b=1", "c=2"))),
        ("--planner.horizon=30", Arguments(overrides=("planner.horizon=30",))),
        ("restart planner", Arguments("restart", service="planner")),
        ("control restart sim", Arguments("restart", machine="control", service="sim")),
        ("logs", Arguments("logs")),
        ("logs sim", Arguments("logs", service="sim")),
    ],
)
def test_words_and_options_in_any_order(line: str, expected: Arguments) -> None:
    assert parse(line.split()) == expected


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("control strat", "strat: no such command"),
        ("restart", "restart: which service"),
        ("up sim", "sim: one word too many"),
        ("--confg debug", "--confg: no such option"),
        ("--config", "--config: needs a value"),
    ],
)
def test_mistakes_are_named_in_one_line(line: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        parse(line.split())


def test_an_unusable_cell_ends_with_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--config", "debug", "--set", "seed=-1", "status"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["nowhere", "--config", "three_machines", "up"]) == 2
    assert "nowhere: no such machine" in capsys.readouterr().err


def test_help_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "restart SERVICE" in capsys.readouterr().out

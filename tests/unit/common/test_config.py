"""A configuration is right as a whole or refused with one line per mistake."""

import pytest
from pydantic import ValidationError

from common.cell import SharedConfig
from common.config import ConfigError, Frozen, digest, load, parse, read_yaml, with_overrides


class Inner(Frozen):
    rate_hz: float = 25.0
    names: tuple[str, ...] = ()


class Outer(Frozen):
    count: int = 1
    inner: Inner = Inner()


def write(tmp_path, text):
    path = tmp_path / "cell.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def mistakes(action):
    with pytest.raises(ConfigError) as failure:
        action()
    assert str(failure.value) == "\n".join(failure.value.lines)
    return failure.value.lines


def test_three_mistakes_are_three_lines(tmp_path):
    path = write(tmp_path, "count: many\nspeed: 3\ninner:\n  rate_hz: .nan\n")
    assert mistakes(lambda: load(Outer, path)) == [
        "cell.yaml: count: input should be a valid integer, "
        "unable to parse string as an integer (given: 'many')",
        "cell.yaml: inner.rate_hz: input should be a finite number (given: nan)",
        "cell.yaml: speed: no such key",
    ]


def test_a_rule_over_several_values_is_one_line_as_well():
    lines = mistakes(lambda: parse(SharedConfig, {"control": {"steps_per_plan": 0}}, "cell.yaml"))
    assert lines == ["cell.yaml: control: steps_per_plan must be auto or from 1 to 50"]


def test_overrides_reach_into_sections_and_are_read_as_yaml(tmp_path):
    path = write(tmp_path, "inner:\n  rate_hz: 10\n")
    config = load(Outer, path, ["count=3", "inner.rate_hz=2.5", "inner.names=[a, b]"])
    assert config == Outer(count=3, inner=Inner(rate_hz=2.5, names=("a", "b")))


def test_an_override_makes_the_section_that_it_needs_and_leaves_the_source_alone():
    source = {"inner": {"rate_hz": 1}}
    assert with_overrides(source, ["other.deep.value=null"]) == {
        "inner": {"rate_hz": 1},
        "other": {"deep": {"value": None}},
    }
    assert source == {"inner": {"rate_hz": 1}}


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("count", "--set count: write it as a.b=value"),
        ("=3", "--set =3: write it as a.b=value"),
        ("count=[1", "--set count=[1: the value is not YAML"),
        ("count.x=1", "--set count.x=1: count holds a value, not a section"),
    ],
)
def test_a_bad_override_is_one_line(override, complaint):
    assert mistakes(lambda: with_overrides({"count": 1}, [override])) == [complaint]


def test_an_override_cannot_bring_in_an_unknown_key(tmp_path):
    path = write(tmp_path, "")
    assert mistakes(lambda: load(Outer, path, ["inner.rate=1"])) == ["cell.yaml: inner.rate: no such key"]


def test_an_empty_file_is_all_defaults(tmp_path):
    assert load(Outer, write(tmp_path, "# nothing\n")) == Outer()


def test_what_is_not_a_mapping_is_refused(tmp_path):
    assert mistakes(lambda: read_yaml(write(tmp_path, "- a\n"))) == [
        "cell.yaml: must hold `key: value` lines, found list"
    ]
    lines = mistakes(lambda: read_yaml(write(tmp_path, "a: [1\n")))
    assert len(lines) == 1 and lines[0].startswith("cell.yaml: is not YAML: ")
    missing = tmp_path / "missing.yaml"
    assert mistakes(lambda: read_yaml(missing)) == [f"{missing}: cannot be read (No such file or directory)"]


def test_a_configuration_cannot_be_changed():
    with pytest.raises(ValidationError):
        Outer().count = 2


def test_equal_values_have_equal_digests_however_they_were_written(tmp_path):
    written = load(Outer, write(tmp_path, "inner: {rate_hz: 25}\ncount: 1\n"))
    assert digest(written) == digest(Outer())
    assert len(digest(Outer())) == 12
    assert digest(Outer(count=2)) != digest(Outer())

"""The one reader of YAML: what is plain has its plain value, everything else is one line."""

import math
import time
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenario_files import refusal, write
from uavaou import Family, InputError, Scenario, plain_yaml
from uavaou.experiments.search_space import SearchSpace
from uavaou.experiments.study import Study
from uavaou.experiments.suite import Suite
from uavaou.plain_yaml import parse_yaml, to_yaml
from uavaou.runs.folder import read_config
from uavaou.zoo import zoo_folder

INFINITE, NAMES = math.inf, ["rician", "none", "2026-13-45", "0:30", "08", "0x", "nan", "="]
WHOLE = {"7": 7, "-7": -7, "+1_000": 1000, "0": 0, "0x1F": 31, "0b11": 3, "&a 3": 3, "--- 3": 3}
FRACTIONS = {"1e-4": 1e-4, "15e3": 15e3, "-2.5": -2.5, "1.5e+4": 15e3, ".5": 0.5}
VALUES: list[tuple[str, object]] = [*WHOLE.items(), *FRACTIONS.items()]
VALUES += [(".inf", INFINITE), ("-.INF", -INFINITE), ("true", True), ("No", False), ("'7'", "7"), ("'<<'", "<<")]
VALUES += [(text, None) for text in ("null", "~", "", "# nothing")] + [(name, name) for name in NAMES]
VALUES += [("[1e1, 2, [x]]", [10.0, 2, ["x"]]), ("{low: 15e3, high: 20000}", {"low": 15000.0, "high": 20000})]
VALUES += [("? x", {"x": None})]
REFUSED = [
    ("a: !!bool foo", "the tag !!bool is not read"),
    ("a: !!int ''", "the tag !!int"),
    ("a: !!int '2'", "the tag !!int"),
    ("a: !!timestamp foo", "the tag !!timestamp"),
    ("a: ! 2", "the tag ! "),
    ("a: !!python/object/apply:os.system [ls]", "the tag !!python/object/apply:os.system"),
    ("%TAG !x! tag:me,1:\n---\na: !x!b 2", "line 3: the tag tag:me,1:b"),
    ("a: 1:1", "1:1: YAML reads this in base 60, 61: write that, or '1:1' for text"),
    ("a: -1:30.5", "base 60, -90.5:"),
    ("a: 1" + ":1" * 15, "base 60, "),
    ("a: 1" + ":1" * 150, "...: YAML reads this number in base 8 or 60"),
    ("a: 1" + ":1" * 500_000, "a number of 1,000,001 characters"),
    ("a: 010", "010: YAML reads this as octal, 8: write 10 or 8"),
    ("a: -0_7", "octal, -7"),
    ("a: " + "9" * 401, "a number of 401 characters"),
    ("a: 1\nb: 2\n'a': 3", "f: the key 'a' is given twice (lines 1 and 3)"),
    ("b: {c: 1, c: 2}", "f: the key 'c' is given twice"),
    ("b: 1\n<<: {c: 1}", "line 2: merge keys (<<) are not read"),
    ("a: <<", "merge keys"),
    ("a: &a [*a]", "aliases are not read"),
    ("*a : 1", "aliases are not read"),
    ("[a]: 1", "a list or mapping cannot be a key"),
    ("1\n--- 2", "2 documents, expected one"),
    ("[" * 500, "more than 100 lists and mappings"),
    ("{a: " * 500, "more than 100 lists and mappings"),
    ("a: \0", "not valid YAML: control characters"),
    ("a: \ud800", "not valid YAML: surrogates"),
    ('a: "\\ud800"', "not valid YAML at line 1"),
    ("a: b\nc: d: e", "not valid YAML at line 2"),
    ("%YAML 2.0\n--- a", "not valid YAML at line 1"),
]


@pytest.mark.parametrize(("text", "value"), VALUES)
def test_plain_values_are_read_as_they_look(text: str, value: object) -> None:
    read = parse_yaml(text, "f")
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(("text", "says"), REFUSED, ids=[text[:20] for text, _ in REFUSED])
@pytest.mark.parametrize("parser", ["libyaml", "python"])
def test_everything_else_is_one_line(text: str, says: str, parser: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if parser == "python":
        monkeypatch.setattr(plain_yaml, "_PARSER", yaml.SafeLoader)
        if not says.startswith(("not valid", "a number of 1,")):  # the words of the parsers differ; Python's is slow
            assert says in refusal(lambda: parse_yaml(text, "f"))
        return
    began = time.monotonic()
    assert says in refusal(lambda: parse_yaml(text, "f"))
    assert time.monotonic() - began < 5


def test_the_number_of_values_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain_yaml, "_MOST_VALUES", 10)
    assert parse_yaml(str([0] * 9), "f") == [0] * 9
    assert "more than 10 values" in refusal(lambda: parse_yaml(str([0] * 10), "f"))


odd = st.text("-+.0179:_exab<=y", max_size=6) | st.sampled_from(["<<", "1e5", "2026-01-01", "0:30", "yes", "\u2028"])
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | odd


@settings(max_examples=60)
@given(st.dictionaries(odd, scalars | st.lists(scalars, max_size=3) | st.dictionaries(odd, scalars, max_size=2)))
def test_what_is_written_is_read_back(content: dict[str, object]) -> None:
    assert parse_yaml(to_yaml(content), "f") == content


@settings(max_examples=100)
@given(st.text("-!&*<>|{}[]:,?'\"0a \n%#_.\\\t", max_size=20) | st.text(max_size=10))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(InputError):  # nothing else may be raised
        parse_yaml(text, "f")


def test_the_shipped_files_mean_what_other_readers_read() -> None:
    files = sorted(zoo_folder("scenarios").parent.rglob("*.yaml"))
    assert len(files) > 20
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert parse_yaml(text, str(path)) == yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)), path


@pytest.mark.parametrize(
    "load",
    [Scenario.load, Family.load, Study.load, Suite.load, read_config, lambda path: SearchSpace.load("mappo", path)],
    ids=["scenario", "family", "study", "suite", "config", "search space"],
)
def test_every_file_has_this_reader(load: object, tmp_path: Path) -> None:
    assert callable(load)
    path = write(tmp_path, "base: tiny\nslots: !!int foo\n")
    assert "line 2: the tag !!int is not read" in refusal(lambda: load(path))

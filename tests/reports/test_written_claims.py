"""Verdicts reach a README, and nothing else there is lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.synthetic_study import DEFAULT, write_study
from uavaou.errors import InputError
from uavaou.experiments.results import read_study
from uavaou.reports.claims import Claim, judge
from uavaou.reports.markdown import END
from uavaou.reports.study_report import begin_marker, claims_markdown, write_claims

ANY = "<!-- numbers:claims -->"  # of no study by name
BEGIN = begin_marker("paper")


def test_the_table_is_written_between_the_markers_and_again(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(f"# Mine\n\n{BEGIN}\nthe last table\n{END}\n\nThe end.\n", encoding="utf-8")
    results = read_study(write_study(tmp_path / "study"))
    claims = judge(results)
    write_claims(readme, "paper", claims)
    text = readme.read_text(encoding="utf-8")
    assert text.startswith(f"# Mine\n\n{BEGIN}\n")
    assert text.endswith(f"{END}\n\nThe end.\n")
    assert "the last table" not in text
    assert claims_markdown(claims) in text
    write_claims(readme, "paper", claims)
    assert readme.read_text(encoding="utf-8") == text


def test_every_row_has_its_cells(tmp_path: Path) -> None:
    without = {name: variant for name, variant in DEFAULT.items() if name != "vdn"}
    claims = judge(read_study(write_study(tmp_path / "study", without, seeds=1)))
    rows = [line for line in claims_markdown(claims).splitlines() if line.startswith("|")]
    assert len(rows) == 2 + len(claims)
    assert {row.count("|") for row in rows} == {7}
    assert "none: one training" in "".join(rows)
    assert "nan" not in "".join(rows)


def test_a_readme_without_markers_gets_them(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    claims = judge(read_study(write_study(tmp_path / "study")))
    write_claims(readme, "paper", claims)
    first = readme.read_text(encoding="utf-8")
    assert first.count(BEGIN) == first.count(END) == 1
    write_claims(readme, "paper", claims)
    assert readme.read_text(encoding="utf-8") == first


def test_another_studys_verdicts_are_left_alone(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    claims = [Claim("it flies", "", "not measured", "nothing")]
    name = "a --> b é"  # of a file, too
    readme.write_text(f"{ANY}\nof no study by name\n{END}\n", encoding="utf-8")
    assert write_claims(readme, name, claims) == name
    text = readme.read_text(encoding="utf-8")
    assert "of no study" not in text
    assert text.count("-->") == 2
    assert write_claims(readme, "paper", claims) == name
    assert readme.read_text(encoding="utf-8") == text
    assert write_claims(readme, name, [replace(claims[0], claim="it lands")]) == name
    assert "it lands" in readme.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "text",
    [
        BEGIN,
        ANY,
        f"{END} {BEGIN}",
        f"{BEGIN}\n{BEGIN}\n{END}",
        f"{ANY}\n{BEGIN}\n{END}",
        f"{BEGIN}\n{END}\n{BEGIN}\n{END}",
        f"{BEGIN}\n<!-- numbers:mine -->\n{END}",
        f"<!-- numbers:claims of mine -->\n{END}",
    ],
)
def test_markers_without_a_pair_lose_nothing(tmp_path: Path, text: str) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"README\.md"):
        write_claims(readme, "paper", [Claim("it flies", "", "not measured", "nothing")])
    assert readme.read_text(encoding="utf-8") == text

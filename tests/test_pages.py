"""The numbers of the pages are those of the committed tables, and stand in blocks that a command writes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import pages
from tests.documents import ROOT

RUNNING = {"README.md": "## Results", "results/README.md": "# Results"}  # pages whose text has no numbers from there on
WRITTEN = r"<!-- numbers:.*?<!-- /numbers -->|<!-- claims:begin.*?<!-- claims:end -->|```.*?```|`[^`]*`|\]\([^)]*\)"


@pytest.mark.parametrize("page", pages.PAGES)
def test_the_blocks_are_those_of_the_tables(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert pages.rendered(text) == text


def test_every_block_stands_on_a_page() -> None:
    text = "".join((ROOT / page).read_text(encoding="utf-8") for page in pages.PAGES)
    assert {name for _, name, _ in pages.BLOCK.findall(text)} == set(pages.BLOCKS)


@pytest.mark.parametrize("page", RUNNING)
def test_running_text_has_no_numbers(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    plain = re.sub(WRITTEN, "", text[text.index(RUNNING[page]) :], flags=re.DOTALL)
    found = [line for line in plain.splitlines() if re.search(r"\d", re.sub(r"95 %|Fig\. \d|Figures? \d", "", line))]
    assert found == []


def test_a_number_that_is_not_of_the_tables_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    held = (ROOT / "README.md").read_text(encoding="utf-8")
    (tmp_path / "README.md").write_text(held.replace("| QMIX | ", "| QMIX | 1"), encoding="utf-8")
    monkeypatch.setattr(pages, "PAGES", ("README.md",))
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.setattr("sys.argv", ["pages", "--check"])
    assert pages.main() == 1
    assert "make results" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["pages"])
    assert pages.main() == 0
    assert (tmp_path / "README.md").read_text(encoding="utf-8") == held

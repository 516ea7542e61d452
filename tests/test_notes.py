"""The tests that notes name exist."""

import re

import pytest

from tests.prose import ROOT, pages

NAMED = sorted(
    {
        found
        for page in [*pages("docs/notes"), ROOT / "SECURITY.md"]
        for found in re.findall(r"`(tests/[\w/]+\.py)(?: -k \"?([\w ]+))?", page.read_text(encoding="utf-8"))
    }
)


@pytest.mark.parametrize(("name", "chosen"), NAMED)
def test_a_test_that_a_note_names_exists(name: str, chosen: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    for word in set(chosen.split()) - {"or", "and", "not"}:
        assert re.search(rf"def test_\w*{word}|\"[^\"\n]*{word}", text), word

"""The pages of the manual are written for a reader: short sentences, short parts, and no word that sells."""

from pathlib import Path

import pytest

from tests.prose import MOST_WORDS, PAGES, PARTS, ROOT, faults, faults_of, pages, parts, prose, sentences, words

LONG = " ".join(["One", *(f"w{number}" for number in range(MOST_WORDS - 1))])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_a_page_has_no_fault(page: Path) -> None:
    assert faults_of(page) == []


def test_each_part_is_short() -> None:
    assert list(parts()) == []


@pytest.mark.parametrize("page", PAGES[:1])
def test_a_part_that_is_too_long_is_seen(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PARTS, "README.md", words(page) - 1)
    assert f"README.md: {words(page)} words, at most {words(page) - 1}" in parts()
    assert pages("docs/nowhere") == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"{LONG}.", []),
        (f"{LONG}. {LONG}.", []),
        (f"{LONG} over.", [(3, f"26 words, at most 25: {LONG} over.")]),
        (f"- {LONG}\n  over\n- {LONG}", [(3, f"26 words, at most 25: {LONG} over")]),
        ("It is e.g. a\ndrone.", [(4, "'drone' is not written here")]),
        ("An Episode, simply.", [(3, "'Episode' is not written here"), (3, "'simply' is not written here")]),
        ("See gym-pybullet-drones and `--episodes`, or <!-- simply --> not.", []),
        (f"| {LONG} over |\n\n```\n{LONG} over\n```\n\n    ```\n    a drone\n    ```", []),
        (f"<!-- numbers:x -->\n{LONG} drones\n<!-- /numbers -->", []),
        ("A field of of devices.", [(3, "There's a lexical illusion in 'of of' - a phrase is repeated.")]),
    ],
)
def test_faults_are_seen_and_code_and_tables_are_not_read(text: str, found: list[tuple[int, str]]) -> None:
    read = faults(f"# A page\n\n{text}\n", promises=False)
    assert [(number, what.partition(" (lexical")[0]) for number, what in read] == found


@pytest.mark.parametrize(
    ("first", "well"),
    [
        ("After this page you can fly.", True),
        ("Your own\nfield flies.", True),
        ("After this page a policy flies.", True),
        ("The field is the field.", False),
    ],
)
def test_a_page_begins_with_what_a_reader_can_do(first: str, well: bool) -> None:
    found = faults(f"---\nhide: [toc]\n---\n# What you can do\n\n<!-- a -->\n{first} You read it.\n")
    assert [what.partition(",")[0] for _, what in found] == (
        [] if well else ["the page begins with what you can do after it"]
    )


def test_links_formulas_and_spans_of_code_count_as_what_is_read() -> None:
    text = prose(
        "A [link of five\nwords](page.md#a b) and `code of many words`, $x + y$, **bold** _text_.\n\n$$\na b\n$$"
    )
    assert text == "A link of five\nwords and Q0, Q1, bold text.\n\n\n\n"
    spoken = "First, e.g. this. `It` is second (see Fig. 3). x_y is third!\n\n1. Fourth\n2. Fifth"
    assert [sentence for _, sentence in sentences(prose(spoken))] == [
        "First, e.g.\u00a0this.",
        "Q0 is second (see Fig.\u00a03).",
        "x_y is third!",
        "Fourth",
        "Fifth",
    ]

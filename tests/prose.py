"""The prose of a page, and what is wrong with it: the linter of ``make lint``.

Rules of ours, and those of proselint that ``tests/prose.json`` leaves on. They look at sentences alone: code, tables,
formulas and blocks that a program writes are blank, and each span of code counts as a word.
"""

import re
import sys
from collections.abc import Iterator
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
MOST_WORDS = 25  # of a sentence
# Words of each part of the manual. Each place is a page, or a folder with all its pages.
PARTS = {
    "README.md": 700,
    "docs/tutorials": 2400,
    "docs/how-to": 5000,
    "docs/explanation": 4000,
    "docs/compare.md": 900,
    "results/README.md": 1500,
    "CONTRIBUTING.md": 400,
    "SECURITY.md": 300,
}
OTHERS = ("CHANGELOG.md", "docs/reference/glossary.md", "docs/notes")  # of any length
NO_PROMISE = ("README.md", "CHANGELOG.md", "docs/reference/glossary.md", "docs/notes")  # what a reader can do after it
# What is not written: words that sell or say that something is easy, and second names for things of the glossary.
FORBIDDEN = re.compile(
    r"(?<![\w-])(simply|very|obviously|of course|basically|easily|effortless(?:ly)?|seamless(?:ly)?|powerful"
    r"|blazing(?:ly)?|cutting-edge|state-of-the-art|leverag(?:e|es|ing)|utili[sz](?:e|es|ed|ing)|drones?|episodes?)(?![\w-])",
    re.IGNORECASE,
)
_ABBREVIATIONS = re.compile(r"\b(e\.g|i\.e|vs|cf|al|Fig|Figs|eq|eqs|Eq|Sec|no|approx)\. ")
_END = re.compile(r"(?<=[.!?])[\"'”’)\]]* +(?=[\"'“‘(\[]?(?:[A-Z0-9]|\w+[._]\w))")
_ITEM = re.compile(r"^\s*(?:[-*+]|\d+\.|>|#+|!!!|\?\?\?|===|:)\s+")


def pages(place: str) -> list[Path]:
    """The pages of a place, which is a page or a folder; none if it is not there."""
    path = ROOT / place
    return sorted(path.rglob("*.md")) if path.is_dir() else [path] if path.is_file() else []


PAGES = [page for place in (*PARTS, *OTHERS) for page in pages(place)]


def prose(text: str) -> str:
    """A page's text with as many lines, of which all but sentences is blank."""
    blank = ("^---\n.*?^---$" if text.startswith("---\n") else "(?!)", r"<!-- numbers:\S+ -->.*?<!-- /?numbers -->")
    for pattern in (*blank, r"^ *(```|~~~|\$\$).*?^ *\1 *$", "<!--.*?-->", r"^ *(?:\||<).*?$", r"^ *\[?!\[.*?$"):
        found = re.compile(pattern, re.DOTALL | re.MULTILINE)
        text = found.sub(lambda match: re.sub(r"[^\n]+", "", match[0]), text)
    number = count()
    text = re.sub(
        r"`[^`]+`|(?<![\w$])\$[^$\n]+\$", lambda match: f"Q{next(number)}" + "\n" * match[0].count("\n"), text
    )
    text = re.sub(r"!?\[([^\]]*)\](?:\([^)]*\)|\[[^\]]*\])", r"\1", text)
    return re.sub(r"\*\*|(?<!\w)[*_](?=\w)|(?<=[\w.])[*_](?!\w)|<[^>\n]+>|\{[^}\n]*\}", "", text)


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """The sentences of prose, each with the line in which its paragraph begins. A new item of a list is a paragraph."""
    paragraphs: list[tuple[int, str]] = []
    begins = True
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip() or begins or _ITEM.match(line):
            paragraphs.append((number, ""))
        first, before = paragraphs[-1]
        paragraphs[-1] = first, f"{before} {_ITEM.sub('', line).strip()}".strip()
        begins = not line.strip() or line.startswith("#")
    for number, paragraph in paragraphs:
        kept = _ABBREVIATIONS.sub("\\1.\u00a0", paragraph)
        yield from ((number, sentence) for sentence in _END.split(kept) if _words(sentence))


def _words(text: str) -> int:
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


def words(page: Path) -> int:
    """The number of words of a page's prose."""
    return _words(prose(page.read_text(encoding="utf-8")))


def faults(text: str, promises: bool = True) -> list[tuple[int, str]]:
    """What is wrong with a page, each with its line.

    Args:
        text: of the page.
        promises: whether its first paragraph tells you what you can do after it.
    """
    plain = prose(text)
    found = [
        (number, f"{_words(sentence)} words, at most {MOST_WORDS}: {sentence}")
        for number, sentence in sentences(plain)
        if _words(sentence) > MOST_WORDS
    ]
    for number, line in enumerate(plain.split("\n"), 1):
        found += [(number, f"'{match[0]}' is not written here") for match in FORBIDDEN.finditer(line)]
    if promises:
        heads = {number for number, line in enumerate(plain.split("\n"), 1) if line.startswith("#")}
        number, first = next((each for each in sentences(plain) if each[0] not in heads), (1, ""))
        if not re.search(r"\byour?\b|^after this page", first, re.IGNORECASE):
            found.append((number, f"the page begins with what you can do after it, not with: {first}"))
    return sorted(found + _of_proselint(plain))


def _of_proselint(plain: str) -> list[tuple[int, str]]:
    from proselint.tools import LintFile

    ended = re.sub(r"^(#.*\w)$", r"\1.", plain, flags=re.MULTILINE)  # else a heading is read with what comes after it
    results = LintFile("page", ended).lint(_settings())
    return [(result.pos[0], f"{result.check_result.message} ({result.check_result.check_path})") for result in results]


@cache
def _settings() -> Any:
    from proselint.checks import __register__
    from proselint.config import load_from
    from proselint.registry import CheckRegistry

    CheckRegistry().register_many(__register__)
    return load_from(Path(__file__).with_name("prose.json"))


def faults_of(page: Path) -> list[str]:
    """What is wrong with a page, ready to print."""
    name = page.relative_to(ROOT).as_posix()
    found = faults(page.read_text(encoding="utf-8"), not name.startswith(NO_PROMISE))
    return [f"{name}:{number}: {what}" for number, what in found]


def parts() -> Iterator[str]:
    """The parts of the manual that are too long."""
    for place, most in PARTS.items():
        number = sum(map(words, pages(place)))
        if number > most:
            yield f"{place}: {number} words, at most {most}"


if __name__ == "__main__":
    found = [*parts(), *(fault for page in PAGES for fault in faults_of(page))]
    print("\n".join(found) or f"prose: {len(PAGES)} pages, no warnings")
    sys.exit(bool(found))

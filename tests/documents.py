"""Markdown pages of the repository and what they contain."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "results/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
)


def blocks(page: Path, language: str) -> list[str]:
    """The code blocks of a page in one language; an empty name for those without a language."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return [code for name, code in fenced if name == language]


def prose(page: Path) -> str:
    """A page without its code blocks."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def code_spans(page: Path) -> list[str]:
    """The inline code of a page."""
    return re.findall(r"`([^`\n]+)`", prose(page))


def commands(page: Path) -> Iterator[list[str]]:
    """Every ``uavaou`` command of a page, as arguments."""
    lines = [line for block in blocks(page, "") for line in block.replace("\\\n", " ").splitlines()]
    for text in [*lines, *code_spans(page)]:
        if text.startswith("uavaou "):
            yield shlex.split(text, comments=True)[1:]


def unknown_options(command: Any, arguments: list[str]) -> set[str]:
    """The options among ``arguments`` that neither the ``command`` nor the one below it that they name has."""
    known, left = {"--help"}, list(arguments)
    while True:
        known |= {option for parameter in command.params for option in parameter.opts}
        while left and left[0].startswith("--"):  # such as --plugin FILE.py, before the command's name
            del left[: 1 if left[0] in ("--version", "--help") else 2]
        below = getattr(command, "commands", {})
        if not left or left[0] not in below:
            return {word for word in arguments if word.startswith("--")} - known
        command = below[left.pop(0)]

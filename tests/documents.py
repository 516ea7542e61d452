"""Markdown pages of the repository and what they contain."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

ROOT = Path(__file__).resolve().parents[1]
PAGES = (*sorted(ROOT.glob("*.md")), ROOT / "results" / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
SITE = tuple(page for page in PAGES if page.parent != ROOT / "docs" / "notes")  # those of the documentation site


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


def console(page: Path) -> list[str]:
    """The ``uavaou`` commands of a page's code blocks, with their comments."""
    lines = [line for block in blocks(page, "") for line in block.replace("\\\n", " ").splitlines()]
    return [line for text in lines for line in text.split(" && ") if line.startswith("uavaou ")]


def commands(page: Path) -> Iterator[list[str]]:
    """Every ``uavaou`` command of a page, also of its inline code, as arguments."""
    for text in [*console(page), *code_spans(page)]:
        if text.startswith("uavaou "):
            yield shlex.split(text, comments=True)[1:]


def parse(command: Any, arguments: list[str]) -> None:
    """Parse all names and values of ``arguments``, as the command does before it begins.

    Raises:
        UsageError, InputError: as for a user, but not for an argument that is left out.
    """
    try:
        context = command.make_context("uavaou", list(arguments))
    except typer.BadParameter as error:
        if type(error).__name__ != "MissingParameter":  # the prose names a command without all it needs
            raise
        return
    left = [*context._protected_args, *context.args]
    if left and hasattr(command, "commands"):
        parse(command.commands[left[0]], left[1:])
